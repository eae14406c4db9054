"""Streams of scenes larger than memory: what has no room waits in files, and the bytes are the same."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

import splatree as st
from splatree.io.memory import Scratch
from splatree.stream import workers
from splatree.stream.stream import of_degree, stream
from splatree.stream.workers import affordable

from .conftest import forest

FORMATS = {
    "sog": ("sog", "city", st.StreamOptions(chunk_leaves=40, unit_rows=150)),
    "zip": ("sog", "city.ssog", st.StreamOptions(chunk_leaves=40, unit_rows=150, zip=True)),
    "3dtiles": ("3dtiles", "city", st.StreamOptions(tile_nodes=100)),
    "rad": ("rad", "city.rad", st.StreamOptions()),
    "rad in chunks": ("rad", "city.rad", st.StreamOptions(chunked=True)),
}


@pytest.fixture(scope="module")
def scene():
    """A forest whose nodes follow the pixel."""
    made = forest(900, seed=5, sh_degree=2)
    curves = np.random.default_rng(6).uniform(0.1, 1, (len(made), 4)).astype(np.float32)
    curves[made.tree.is_leaf] = 0
    return replace(made, tree=replace(made.tree, curves=curves))


def bytes_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("degree", [None, 1])
def test_a_stream_has_the_same_bytes_for_any_memory(scene, format, degree, tmp_path):
    name, output, options = FORMATS[format]
    options = replace(options, sh_degree=degree)
    in_files = []

    def tight(target, max_memory):
        return Scratch({"none": 0, "little": 20_000, "much": np.inf}[max_memory], target.parent)

    real = np.memmap

    def counted(*args, **kwargs):
        in_files.append(args)
        return real(*args, **kwargs)

    found = {}
    for memory in ("none", "little", "much"):
        folder = tmp_path / memory
        folder.mkdir()
        in_files.clear()
        with (
            mock.patch("splatree.stream.stream.scratch_beside", tight),
            mock.patch("splatree.io.memory.np.memmap", counted),
        ):
            stream(scene, folder / output, name, options, max_memory=memory)
        assert bool(in_files) == (memory != "much")
        found[memory] = bytes_of(folder)
    assert found["none"] == found["little"] == found["much"]


def test_memory_bounds_the_parts_that_are_made_side_by_side(tmp_path):
    assert [affordable(8, 1000, Scratch(room, tmp_path)) for room in (0, 4_000, 12_500, np.inf)] == [1, 1, 3, 8]
    assert affordable(0, 1, Scratch.endless()) == workers._core.hardware_threads()


def test_harmonics_that_are_left_out_take_no_memory(scene, tmp_path):
    low = of_degree(scene, 1, Scratch(0, tmp_path))
    np.testing.assert_array_equal(low.gaussians.sh, scene.gaussians.sh[:, :4])
    assert low.gaussians.means is scene.gaussians.means and of_degree(scene, 3, Scratch.endless()) is scene


@pytest.mark.parametrize(("memory", "message"), [("1M", "found 1M, wanted at least 250M"), ("lots", "found 'lots'")])
def test_memory_that_cannot_be_is_refused(scene, tmp_path, memory, message):
    with pytest.raises(st.InputError, match=message):
        stream(scene, tmp_path / "city", max_memory=memory)
    assert not any(tmp_path.iterdir())
