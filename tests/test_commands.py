"""The benchmarks and the fuzzers that the documentation names can be started; how long they take keeps them out of the tests."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from splatree.io.registry import formats

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tests/**/*.md"), *ROOT.glob("benchmarks/*.py")]
COMMAND = re.compile(r"\bpython (?:benchmarks|tests|scripts)/[\w/]+\.py\b")
FUZZER = ROOT / "tests" / "fuzz" / "fuzz_readers.py"

START = """
import runpy, sys
sys.path[:0] = [{folder!r}]
for script in {scripts!r}:
    runpy.run_path(script)  # all but main(): what it imports, and its constants
"""


def documented() -> list[str]:
    found = {command for page in PAGES for command in COMMAND.findall(page.read_text())}
    return sorted(command.split()[1] for command in found)


def test_documented_scripts_exist():
    assert "tests/fuzz/fuzz_readers.py" in documented()
    assert [name for name in documented() if not (ROOT / name).is_file()] == []


def test_documented_benchmarks_import_what_there_is():
    folder = ROOT / "benchmarks"
    scripts = sorted(str(path) for path in folder.glob("*.py"))
    run = subprocess.run(
        [sys.executable, "-c", START.format(folder=str(folder), scripts=scripts)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr[-2000:]


@pytest.mark.parametrize("kind", [*(f.name for f in formats()), "sog-folder-1", "sog-folder-2"])
def test_the_fuzzer_has_seeds_for_its_kinds(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    target = runpy.run_path(str(FUZZER))["prepare"](kind, tmp_path)
    assert list((tmp_path / "corpus").iterdir()) and target.is_relative_to(tmp_path)


def test_mutants_change_one_thing_each_and_not_the_words_of_errors():
    source = "def f(a: int = 3) -> bool:\n    if a < 2:\n        raise ValueError(f'{a + 1}')\n    return not a\n"
    found = dict(runpy.run_path(str(ROOT / "scripts" / "mutate"))["mutants"](source))
    assert sorted(found) == ["1: 3  →  4", "2: 2  →  3", "2: a < 2  →  a <= 2", "4: not a  →  a"]
    assert found["2: a < 2  →  a <= 2"].splitlines()[1] == "    if a <= 2:"
    assert all("raise ValueError(f'{a + 1}')" in changed for changed in found.values())


def test_the_fuzzer_takes_the_installed_package():
    code = f"import runpy, sys; before = list(sys.path); runpy.run_path({str(FUZZER)!r}); print(set(sys.path) - set(before))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert str(ROOT / "src") not in run.stdout
