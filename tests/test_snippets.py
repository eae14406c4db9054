"""What the pages show runs as it stands there: Python blocks, lines of commands, names of benchmarks."""

import importlib
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import tyro

import splatree as st
from splatree.cli import bench
from splatree.cli.main import VERBS, main

compare = importlib.import_module("splatree.render.compare")  # splatree.render is the function
ROOT = Path(__file__).parent.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")])
PAGES = [page for page in PAGES if page.name not in ("cli.md", "use-a-gpu.md")]  # generated; needs a GPU
MORE = (
    {"eval": ["--frames", "2", "--width", "64"]}
    | {verb: ["--force"] for verb in ("build", "convert", "render", "thin")}
    | {"train": ["--force", "--iterations", "2", "--max-gaussians", "200"]}
    | {"render": ["--force", "--width", "64", "--height", "36"]}
)
"""What keeps a command quick, and lets it write over the files of the folder."""


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.DOTALL)


def commands():
    """Each command of the pages that names its inputs, as page and words, without what the shell takes as a comment."""
    found = []
    for page in PAGES:
        text = page.read_text()
        prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
        shown = [
            line for block in re.findall(r"```(?:sh)?\n(.*?)```", text, flags=re.DOTALL) for line in block.splitlines()
        ]
        shown += [span.replace("\n", " ") for span in re.findall(r"`(splatree [^`]*)`", prose)]
        for line in shown:
            if not line.startswith("splatree "):
                continue
            words = shlex.split(line, comments=True)
            if len(words) < 3 or words[2].startswith("-"):
                continue  # only the name of a verb or of an option
            if not any(word.isupper() or "…" in word for word in words):
                found.append(pytest.param(words[1:], id=f"{page.name}: {shlex.join(words[1:])}"))
    return found


WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_python_runs_as_shown(page, shown_folder, monkeypatch, capsys):
    small = replace(compare.MADE, width=64, height=36)  # FLIP of eight views at full size takes 15 s
    monkeypatch.setattr(compare, "MADE", small)
    scene = st.read("city.splatree")
    names = {"scene": scene, "camera": st.flyout(scene, st.PathOptions(views=1, width=64, height=36))[0]}
    for block in blocks(page, "python"):
        exec(compile(block, page.name, "exec"), names)


@pytest.mark.parametrize("words", commands())
def test_command_runs_as_shown(words, shown_folder, capsys):
    verb, *rest = words
    rest = [name for word in rest for name in (sorted(map(str, shown_folder.glob(word))) if "*" in word else [word])]
    if verb == "bench":  # takes minutes: its line is parsed alone
        command_type, *rest = bench.COMMANDS[rest[0]], *rest[1:]
        tyro.cli(command_type, args=rest, config=(tyro.conf.FlagCreatePairsOff,))
        return
    assert verb in VERBS
    if "--minutes" in rest and verb == "train":  # steps are counted here
        place = rest.index("--minutes")
        rest = rest[:place] + rest[place + 2 :]
    code = main([verb, *rest, *MORE.get(verb, [])])
    assert code == 0, capsys.readouterr().err


def test_pages_show_commands():
    assert len(commands()) > 20
    assert len(WITH_PYTHON) > 8


@pytest.mark.parametrize("page", [*PAGES, ROOT / "benchmarks" / "RESULTS.md"], ids=lambda page: page.name)
def test_named_benchmarks_scripts_and_sources_exist(page):
    named = re.findall(r"`(?:python )?((?:benchmarks|scripts|src/splatree|tests|docs)/[\w./-]+\w)`", page.read_text())
    assert [name for name in named if not (ROOT / name).exists()] == []
