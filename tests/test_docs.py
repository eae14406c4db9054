"""What the pages promise is there: files they link to, options they list, commands they show."""

import re
import shlex
from pathlib import Path

import pytest

import splatree
from splatree.cli.main import GROUPS, VERBS, commands_of, main

ROOT = Path(__file__).parent.parent
PAGES = sorted(p.relative_to(ROOT) for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("src/**/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    targets = [target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target]
    missing = [target for target in targets if target and not (ROOT / page).parent.joinpath(target).exists()]
    assert missing == []


def test_each_page_is_one_of_four_kinds_and_in_the_navigation():
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    kinds = ("tutorial/", "how-to/", "reference/", "explanation/")
    assert [page for page in pages if page != "index.md" and not page.startswith(kinds)] == []
    navigation = re.findall(r"^ +- (?:[\w ]+: )?(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), flags=re.MULTILINE)
    assert [page for page in pages if page not in navigation] == [], "name them in mkdocs.yml"
    assert len(navigation) == len(set(navigation))


@pytest.mark.parametrize("page", [page for page in PAGES if {"tutorial", "how-to"} & set(page.parts)], ids=str)
def test_commands_of_a_page_can_be_run_one_after_the_other(page):
    """None writes what another one of the page has written, which would be refused."""
    lines = [shlex.split(line, comments=True) for line in re.findall(r"^splatree .*$", (ROOT / page).read_text(), re.M)]
    writing = [
        line
        for line in lines
        if line[1] in ("convert", "thin", "build", "clean", "refine", "render", "stream", "train")
    ]
    written = []
    for line in writing:
        named = line[line.index("-o") + 1 : line.index("-o") + 2] if "-o" in line else []
        paths = [word for word in line[2:] if re.search(r"\.(ply|spz|sog|splat|ksplat|splatree|glb|rad|hier)$", word)]
        if not {"--force", "--dry-run", "--cameras"} & set(line):
            written += named or paths[1:][-1:]
    assert sorted(written) == sorted(set(written))


def test_the_first_page_leads_to_each_page():
    """But for the pages of the reference that an index of their own lists."""
    first = (ROOT / "docs" / "index.md").read_text()
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    listed = [page for page in pages if page != "index.md" and not page.startswith("reference/formats/")]
    assert [page for page in listed if page not in first] == []


def test_the_tests_that_the_page_of_promises_names_are_there():
    page = (ROOT / "docs" / "explanation" / "what-is-held.md").read_text()
    there = {
        name
        for path in ROOT.glob("tests/**/test_*.py")
        for name in re.findall(r"^def (test_\w+)", path.read_text(), re.M)
    }
    named = re.findall(r"`(test_\w+)`", page)
    assert len(named) > 50 and [name for name in named if name not in there] == []
    files = re.findall(r"`((?:scripts|benchmarks)/[\w.]+)", page)
    assert [name for name in files if not (ROOT / name).exists()] == []


def test_reference_shows_each_public_name_once():
    """By its public name, or by its home where a package has the same name: `splatree.render` is both."""
    pages = [*(ROOT / "docs" / "reference").rglob("*.md")]
    shown = [
        name for page in pages for name in re.findall(r"^::: splatree\.(.+)$", page.read_text(), flags=re.MULTILINE)
    ]
    assert sorted(name.split(".")[-1] for name in shown) == splatree.__all__
    packages = {path.parent.name for path in (ROOT / "src" / "splatree").glob("*/__init__.py")}
    assert [name for name in shown if name in packages] == []


COMMANDS = [*VERBS, *(f"{group} {command}" for group in GROUPS for command in commands_of(group))]


@pytest.mark.parametrize("command", COMMANDS)
def test_command_line_page_lists_every_option(command, capsys):
    page = (ROOT / "docs" / "reference" / "cli.md").read_text()
    assert f"## splatree {command}\n" in page, "run scripts/docs"
    section = page.split(f"## splatree {command}\n")[1].split("\n## ")[0]
    assert main([*command.split(), "--help"]) == 0
    options = set(re.findall(r"--[a-z][a-z0-9.-]+", capsys.readouterr().out))
    missing = [option for option in sorted(options) if option not in section]
    assert missing == [], "run scripts/docs"


def test_readme_shows_verbs_that_exist():
    lines = re.findall(r"^splatree ([a-z]+) +\S", (ROOT / "README.md").read_text(), flags=re.MULTILINE)
    assert lines
    assert set(lines) <= set(VERBS)


def test_readme_commands_are_the_ones_that_are_checked():
    """``.ci/run`` takes the test command out of the README: there must be one, and one for the demo."""
    commands = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("python3 -m venv")]
    ends = [command.rpartition(" && ")[2] for command in commands]
    assert ends == [".venv/bin/splatree demo", ".venv/bin/python -m pytest -n auto --dist worksteal"]
