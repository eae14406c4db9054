"""A .rad as a stream: one file, or a header with a file for each chunk."""

import dataclasses
import json

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.rad import nodes, writer
from splatree.io.formats.rad.container import open_rad
from splatree.kernels.cpu.codec import paging

from .conftest import forest

CHUNKED = st.StreamOptions(chunked=True)
COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


@pytest.fixture
def scene(monkeypatch):
    """A scene of several chunks, which here have 256 nodes."""
    monkeypatch.setattr(writer, "_CHUNK_ROWS", 256)
    order = paging.page_order
    monkeypatch.setattr(nodes, "page_order", lambda *a: order(*a, page_rows=256))
    return forest(1200, seed=2, sh_degree=1)


def test_chunks_of_their_own_hold_what_one_file_holds(scene, tmp_path):
    one = st.stream(scene, tmp_path / "one.rad", "rad")
    many = st.stream(scene, tmp_path / "many.rad", "rad", CHUNKED)
    back, wanted = st.read(tmp_path / "many.rad"), st.read(tmp_path / "one.rad")
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(back.gaussians, column), getattr(wanted.gaussians, column))
    np.testing.assert_array_equal(back.tree.subtree_end, wanted.tree.subtree_end)

    files = sorted(tmp_path.glob("many-*.radc"), key=lambda path: int(path.name.split("-")[1]))
    chunks = open_rad(tmp_path / "one.rad").chunks
    whole = (tmp_path / "one.rad").read_bytes()
    assert [path.stat().st_size for path in files] == [chunk.num_bytes for chunk in chunks]
    assert all(path.read_bytes() in whole for path in files)
    assert (one.num_parts, many.num_parts) == (1, 5)
    assert many.bytes == sum(path.stat().st_size for path in (tmp_path / "many.rad", *files))


def test_the_header_is_what_spark_reads(scene, tmp_path):
    """Little-endian length, JSON, zeros to a multiple of 8; each chunk begins at byte 0 of the file beside the header."""
    st.stream(scene, tmp_path / "many.rad", "rad", CHUNKED)
    data = (tmp_path / "many.rad").read_bytes()
    length = int.from_bytes(data[4:8], "little")
    meta = json.loads(data[8 : 8 + length])
    assert data[:4] == b"RAD0" and len(data) == 8 + -(-length // 8) * 8 and not any(data[8 + length :])
    assert [entry["offset"] for entry in meta["chunks"]] == [0] * 4
    for number, entry in enumerate(meta["chunks"]):
        path = tmp_path / entry["filename"]
        assert entry["filename"].startswith(f"many-{number}-") and path.stat().st_size == entry["bytes"]
    assert meta["allChunkBytes"] == sum(entry["bytes"] for entry in meta["chunks"])


def test_an_older_stream_is_replaced_and_nothing_else(scene, tmp_path):
    st.stream(scene, tmp_path / "city.rad", "rad", CHUNKED)
    old = set(tmp_path.glob("*.radc"))
    (tmp_path / "city-2-notes.radc").write_text("mine")
    with pytest.raises(st.OutputError, match="exists"):
        st.stream(scene, tmp_path / "city.rad", "rad", CHUNKED)
    smaller = dataclasses.replace(scene, gaussians=scene.gaussians.with_sh_degree(0))
    st.stream(smaller, tmp_path / "city.rad", "rad", CHUNKED, force=True)
    assert not old & set(tmp_path.glob("*.radc")) and (tmp_path / "city-2-notes.radc").read_text() == "mine"
    assert st.read(tmp_path / "city.rad").gaussians.sh_degree == 0


def test_a_missing_chunk_is_named(scene, tmp_path):
    st.stream(scene, tmp_path / "city.rad", "rad", CHUNKED)
    next(tmp_path.glob("city-2-*.radc")).unlink()
    with pytest.raises(st.FormatError, match=r"city-2-[0-9a-f]{12}\.radc"):
        st.read(tmp_path / "city.rad")


def test_the_report_counts_the_bytes_of_the_chunks(scene, tmp_path):
    camera = st.Camera.look_at([0.5, 0.5, -3.0], [0.5, 0.5, 0.5], width=96, height=64)
    found = [
        st.report_stream(scene, st.stream(scene, tmp_path / name, "rad", options), [camera], budgets=[200]).views
        for name, options in (("one.rad", None), ("many.rad", CHUNKED))
    ]
    assert found[0] == found[1]
