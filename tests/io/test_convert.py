"""Conversions from file to file: in chunks and whole give the same bytes, and memory is bounded."""

import json
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import splatree
from splatree import (
    ConvertOptions,
    EditOptions,
    InputError,
    OutputError,
    ReadOptions,
    Scene,
    WriteOptions,
    convert,
    edit,
)
from splatree.io import chunks, memory, rows
from splatree.io.formats.ply import format as ply
from splatree.io.formats.splat import format as splat
from splatree.io.registry import formats

from ..scenes import random_gaussians

IN_CHUNKS = [f.suffixes[0] for f in formats() if f.write_chunks]

EDITS = [
    EditOptions(),
    EditOptions(scale=2.0, rotate=(10.0, 20.0, 30.0), translate=(1.0, 2.0, 3.0), sh_degree=1),
    EditOptions(min_opacity=0.5, crop_box=(-9.0, -9.0, -9.0, 9.0, 9.0, 9.0)),
    EditOptions(crop_box=(0.0, 0.0, 0.0, 4.0, 4.0, 4.0)),  # which leaves nothing of many chunks
]


@pytest.fixture
def small_chunks(monkeypatch):
    """Chunks of 100 rows, so that small scenes have several."""
    for module in (ply, splat, chunks, rows):
        monkeypatch.setattr(module, "ROWS_PER_CHUNK", 100)


@pytest.mark.parametrize("suffix", IN_CHUNKS)
@pytest.mark.parametrize("edits", EDITS)
def test_chunks_and_whole_scene_give_the_same_bytes(tmp_path, small_chunks, suffix, edits):
    splatree.write(Scene.flat(random_gaussians(777, 2)), tmp_path / "a.ply")
    done = convert(tmp_path / "a.ply", tmp_path / f"b{suffix}", ConvertOptions(edit=edits))
    assert done.in_chunks and done.num_read == 777
    whole = edit(splatree.read(tmp_path / "a.ply"), edits)
    lost = splatree.write(whole, tmp_path / f"c{suffix}")
    assert (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"c{suffix}").read_bytes()
    assert done.num_written == len(whole) and done.lost == lost


@pytest.mark.parametrize("suffix", IN_CHUNKS)
def test_the_bytes_do_not_depend_on_the_memory(tmp_path, small_chunks, suffix):
    gaussians = random_gaussians(1777, 2)
    gaussians.means[:300] = gaussians.means[0]  # many of one key
    splatree.write(Scene.flat(gaussians), tmp_path / "a.ply")
    for order in ("kept", "morton"):
        options = ConvertOptions(edit=EditOptions(order=order))
        convert(tmp_path / "a.ply", tmp_path / f"b{suffix}", options, force=True)
        with mock.patch.object(memory, "free_bytes", lambda: 0):
            done = convert(tmp_path / "a.ply", tmp_path / f"c{suffix}", options, force=True)
        assert done.in_chunks and (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"c{suffix}").read_bytes()
        assert not list(tmp_path.glob(".*"))
    whole = edit(splatree.read(tmp_path / "a.ply"), EditOptions(order="morton"))
    splatree.write(whole, tmp_path / f"d{suffix}")
    assert (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"d{suffix}").read_bytes()


def test_a_scene_with_levels_is_gone_through_leaf_by_leaf(tmp_path, small_chunks):
    splatree.write(Scene.flat(random_gaussians(1500, 1)), tmp_path / "a.ply")
    options = splatree.BuildOptions(radius=0.3, max_roots=4, follow=False)
    folder = splatree.build_folder(
        tmp_path / "a.ply", tmp_path / "parts.splatree", options, splatree.FolderOptions(part_rows=200)
    ).path
    whole = splatree.read(folder)
    clusters = splatree.build_clusters(whole, 8)
    splatree.write(clusters, tmp_path / "one.splatree")
    for source, scene in ((folder, whole), (tmp_path / "one.splatree", clusters)):
        done = convert(source, tmp_path / "b.ply", force=True)
        lost = splatree.write(scene, tmp_path / "c.ply", force=True)
        assert done.in_chunks and done.lost == lost and "merged nodes: ply gets the leaves" in lost[0]
        assert (done.num_read, done.num_written) == (1500, 1500)
        assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()
    assert not convert(tmp_path / "one.splatree", tmp_path / "d.splatree").in_chunks  # which keeps the clusters


def test_memory_that_is_not_kept_to_is_refused(tmp_path):
    splatree.write(Scene.flat(random_gaussians(5, 0)), tmp_path / "a.hier")
    with pytest.raises(
        InputError,
        match=r"max_memory: found 1G for .*b\.rad, but this conversion holds the whole.*; reading .*a\.hier takes about 130 MB;",
    ):
        convert(tmp_path / "a.hier", tmp_path / "b.rad", ConvertOptions(write=WriteOptions(max_memory="1G")))
    with pytest.raises(InputError, match="max_memory: found 100M, wanted at least 250M"):
        WriteOptions(max_memory="100M")


def test_a_file_that_is_read_whole_and_has_no_room_is_refused_before_it_is_read(tmp_path, monkeypatch):
    for name, options in (("full.hier", None), ("half.hier", WriteOptions(compression=1))):
        path = tmp_path / name
        splatree.write(Scene.flat(random_gaussians(100, 0)), path, options=options)
        monkeypatch.setattr("splatree.io.reading.free_bytes", lambda: 130_030_000)
        assert len(splatree.read(path)) == 100
        monkeypatch.setattr("splatree.io.reading.free_bytes", lambda: 130_029_999)
        monkeypatch.setattr("splatree.io.formats.hier.format.read", None)
        assert convert(path, tmp_path / "b.ply", force=True).in_chunks and splatree.check(path)[0].by_pages
        for verb in (splatree.read, lambda path: convert(path, tmp_path / "b.rad")):
            with pytest.raises(
                InputError, match=r"\.hier: takes about 0\.1 GB in memory.*read whole; found 0\.1 GB free"
            ):
                verb(path)
        monkeypatch.undo()


def test_each_format_that_is_read_in_chunks_gives_what_it_gives_whole(tmp_path, small_chunks):
    for f in formats():
        if f.read_chunks is None or not f.suffixes:  # folders of tiles: test_pieces_in_chunks.py
            continue
        splatree.write(Scene.flat(random_gaussians(777, 2)), tmp_path / f"a{f.suffixes[0]}")
        assert convert(tmp_path / f"a{f.suffixes[0]}", tmp_path / "b.ply", force=True).in_chunks
        splatree.write(splatree.read(tmp_path / f"a{f.suffixes[0]}"), tmp_path / "c.ply", force=True)
        assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()


@pytest.mark.parametrize("suffix", IN_CHUNKS)
def test_several_files_are_one_scene_in_chunks_too(tmp_path, small_chunks, suffix):
    for i, degree in enumerate((0, 3, 1)):
        splatree.write(Scene.flat(random_gaussians(150, degree, seed=i)), tmp_path / f"{i}.ply")
    parts = [tmp_path / f"{i}.ply" for i in range(3)]
    assert convert(parts, tmp_path / f"b{suffix}").in_chunks
    splatree.write(splatree.read(parts), tmp_path / f"c{suffix}")
    assert (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"c{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".ply", ".hier"], ids=["in chunks", "in memory"])
def test_files_of_different_modes_are_joined_only_in_a_mode_that_is_told(tmp_path, suffix):
    splatree.write(Scene.flat(random_gaussians(1)), tmp_path / "a.ply")
    splatree.write(Scene.flat(random_gaussians(1), mode="antialiased"), tmp_path / "b.ply")
    paths, target = [tmp_path / "a.ply", tmp_path / "b.ply"], tmp_path / f"c{suffix}"
    with pytest.raises(InputError, match=r"differ in their mode.*--mode"):
        convert(paths, target)
    assert convert(paths, target, ConvertOptions(mode="antialiased")).num_written == 2
    assert splatree.read(target).mode == ("antialiased" if suffix == ".ply" else "classic")


@pytest.mark.parametrize("repair", [True, "drop"])
def test_repairs_are_counted_and_rows_that_are_dropped_are_not_written(tmp_path, small_chunks, repair):
    g = random_gaussians(555, 1)
    g.means[[3, 500], 0] = np.nan
    g.log_scales[7] = 99
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    done = convert(tmp_path / "a.ply", tmp_path / "b.ply", ConvertOptions(ReadOptions(repair=repair)))
    wanted = {"dropped_rows": 2, "clamped_scales": 1} if repair is True else {"dropped_rows": 3}
    assert done.in_chunks and done.repairs == wanted
    assert len(splatree.read(tmp_path / "b.ply")) == done.num_written == 555 - wanted["dropped_rows"]


def test_infinite_logits_are_counted_without_repair(tmp_path, small_chunks):
    g = random_gaussians(555, 1)
    g.logit_opacities[[3, 4, 500]] = np.inf
    for name in ("a.ply", "a2.ply"):
        splatree.write(Scene.flat(g), tmp_path / name)
    for inputs, count in (([tmp_path / "a.ply"], 3), ([tmp_path / "a.ply", tmp_path / "a2.ply"], 6)):
        for edits in (EditOptions(), EditOptions(min_opacity=0.5), EditOptions(order="morton")):
            done = convert(inputs, tmp_path / "b.spz", ConvertOptions(edit=edits), force=True)
            assert done.in_chunks and done.repairs == {"clamped_opacities": count}


def test_what_the_reader_lost_is_said(tmp_path):
    path = tmp_path / "a.ply"
    splatree.write(Scene.flat(random_gaussians(5, 0)), path)
    path.write_bytes(path.read_bytes().replace(b"end_header", b"comment SplatRenderMode: 2dgs\nend_header"))
    assert convert(path, tmp_path / "b.ply").lost[0].startswith("the surfels' own rule")
    lost = convert(path, tmp_path / "c.ply", ConvertOptions(edit=EditOptions(order="morton"))).lost
    assert lost[0].startswith("the surfels' own rule")


@pytest.mark.parametrize("scale", [1e12, 1e-12])
@pytest.mark.parametrize("suffix", [".ply", ".spz", ".splatree"])
@pytest.mark.parametrize("has_levels", [False, True])
def test_what_an_edit_moves_beyond_what_is_read_is_not_written(tmp_path, scale, suffix, has_levels):
    g = random_gaussians(50, 0)
    g.means[:] *= 1e4
    scene = Scene.flat(g)
    splatree.write(splatree.build_lod(scene) if has_levels else scene, tmp_path / "a.splatree")
    with pytest.raises(InputError, match=r"row \d+, .*: found .*, wanted .* rows have such values$"):
        splatree.convert(
            tmp_path / "a.splatree", tmp_path / f"b{suffix}", ConvertOptions(edit=EditOptions(scale=scale))
        )
    assert not (tmp_path / f"b{suffix}").exists()


def test_a_failure_half_way_leaves_the_old_file_whole(tmp_path, small_chunks):
    g = random_gaussians(555, 1)
    g.means[500, 0] = np.nan
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    (tmp_path / "b.ply").write_text("old")
    with pytest.raises(InputError, match="row 500"):
        convert(tmp_path / "a.ply", tmp_path / "b.ply", force=True)
    with pytest.raises(OutputError, match="exists already"):
        convert(tmp_path / "a.ply", tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_text() == "old" and len(list(tmp_path.iterdir())) == 2


def test_options_of_other_formats_are_refused(tmp_path):
    splatree.write(Scene.flat(random_gaussians(5, 0)), tmp_path / "a.ply")
    with pytest.raises(InputError, match="this format takes none"):
        convert(tmp_path / "a.ply", tmp_path / "b.ply", ConvertOptions(write=WriteOptions(iterations=3)))


LIMITED = """
import json, resource, sys
import splatree
from splatree.io.convert import convert
import splatree.io.reading
splatree.io.memory.free_bytes = lambda: 280_000_000  # half of which leaves 10 MB for what waits
source, target, small, limit = sys.argv[1:]
convert(small, target, force=True)  # what is loaded and kept from a first run is not counted
with open("/proc/self/statm") as file:
    data = int(file.read().split()[5]) * resource.getpagesize()  # data and stack, as RLIMIT_DATA counts them
resource.setrlimit(resource.RLIMIT_DATA, (data + int(limit),) * 2)
try:
    splatree.read(source)
except MemoryError:
    read = False
else:
    read = True
print(json.dumps([read, convert(source, target, force=True).num_written]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs RLIMIT_DATA as Linux has it")
@pytest.mark.parametrize("suffix", IN_CHUNKS)
def test_a_file_larger_than_the_memory_allowed_is_converted(tmp_path, suffix):
    """A file of 60 MB in 40 MB of memory, a limit that the system holds: reading it whole fails."""
    times = 2 if suffix == ".rad" else 1  # whose chunks are four times as long
    rows = 250_000 * times
    splatree.write(Scene.flat(random_gaussians(1000, 3)), tmp_path / "small.ply")
    data = (tmp_path / "small.ply").read_bytes()
    head, mark, body = data.replace(b"vertex 1000\n", b"vertex %d\n" % rows).partition(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(head + mark + body * (rows // 1000))
    words = [tmp_path / "a.ply", tmp_path / f"b{suffix}", tmp_path / "small.ply", 40_000_000 * times]
    environment = {**os.environ, "PYTHONPATH": str(Path(splatree.__file__).parents[1])}
    out = subprocess.run(
        [sys.executable, "-c", LIMITED, *map(str, words)], check=True, capture_output=True, text=True, env=environment
    )
    assert json.loads(out.stdout) == [False, rows]
