"""Every format that is registered is described where users look."""

from pathlib import Path

import pytest

from splatree.io.registry import formats

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "formats" / "index.md"
MANIFESTS = {"streamed-sog": "lod-meta.json", "3d-tiles": "tileset.json", "splatree-folder": "manifest.json"}


@pytest.mark.parametrize("f", formats(), ids=lambda f: f.name)
def test_the_table_of_formats_has_each(f):
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("|")]
    marks = [f"`{suffix}`" for suffix in f.suffixes] or [MANIFESTS[f.name]]
    for mark in marks:
        line = next((line for line in lines if mark in line), "")
        assert "](" in line, f"no line with a page for {mark}"
        assert ("write" in line) == f.is_written
        assert ("kept" in line) == (f.holds.levels == "tree")
