"""Hooks of MkDocs: pages from outside docs/ join the site.

ARCHITECTURE.md, CONTRIBUTING.md, CHANGELOG.md, the measurements and the examples stay where a reader of the repository looks
for them. The site shows them too. A link between any two pages is written for the repository; here it is turned to the place
of its target in the site. A link to a file that the site does not show becomes the bare name.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
PAGES = {
    "ARCHITECTURE.md": "project/architecture.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "benchmarks/RESULTS.md": "project/results.md",
} | {f"examples/{path.name}": f"project/examples/{path.stem}.md" for path in ROOT.glob("examples/*.py")}
"""Place in the site by place in the repository, for what lies outside docs/."""
ALIASES = {"README.md": "index.md"}
"""Pages whose part is played by another one."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/."""
    for source, target in PAGES.items():
        text = (ROOT / source).read_text()
        files.append(File.generated(config, target, content=_example(source, text) if source.endswith(".py") else text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to where their targets are in the site."""
    here = page.file.src_uri
    written_in = next((source for source, target in PAGES.items() if target == here), f"docs/{here}")

    def turned(link: re.Match[str]) -> str:
        text, target = link.groups()
        path, _, anchor = target.partition("#")
        if "://" in target or not path:
            return link[0]
        source = posixpath.normpath(posixpath.join(posixpath.dirname(written_in), path))
        place = ALIASES.get(source) or PAGES.get(source) or source.removeprefix("docs/")
        if place == source:
            return text
        return f"[{text}]({posixpath.relpath(place, posixpath.dirname(here) or '.')}{'#' + anchor if anchor else ''})"

    parts = re.split(r"(^```.*?^```$)", markdown, flags=re.DOTALL | re.MULTILINE)
    return "".join(
        part if part.startswith("```") else re.sub(r"\[([^]]*)\]\(([^)\s]+)\)", turned, part) for part in parts
    )


def _example(source: str, text: str) -> str:
    """An example as a page: its docstring's first line says what it shows."""
    return f"# {Path(source).stem.replace('_', ' ').capitalize()}\n\n`{source}`\n\n```python\n{text}```\n"
