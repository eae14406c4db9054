"""What goes by pages needs memory for pages: far less than the scene, measured in a process of its own."""

import json
import subprocess
import sys

import pytest

import splatree as st

from ..scenes import cloud

PROGRAM = '''
import json, sys, threading
from pathlib import Path
import splatree as st
from splatree.cli.info import describe
from splatree.io import outline, rows
from splatree.io.formats.folder import whole
from splatree.io.formats.glb import reader
from splatree.io.memory import Scratch
from splatree.io.options import ReadOptions
from splatree.outofcore import clustering
from splatree.view.exhibit import exhibit
from splatree.view.shown import OnDisk
from splatree.view.slots import Slots

whole.ROWS_PER_CHUNK, outline.FOLDER_RUN, outline.FOLDER_SAMPLE, outline.SAMPLE = 1000, 1000, 2000, 2000
rows.ROWS_PER_CHUNK = reader.ROWS_PER_CHUNK = clustering.ROWS_PER_CHUNK = 1000
small, large, output = map(Path, sys.argv[1:])


def anonymous():
    """Memory of this process that no file backs, bytes."""
    with open("/proc/self/status") as status:
        return next(1024 * int(line.split()[1]) for line in status if line.startswith("RssAnon"))


def view(folder):
    camera = st.Camera.look_at((3, -2, 1), (0, 0, 0), up=(0, -1, 0), width=64, height=36, fov_y_deg=50)
    with st.open_store(folder, max_memory="1M") as store, st.open_session(store) as session:
        slots = Slots(OnDisk(store), camera.position * 0, 4096)
        for error in (2000, 500, 200):
            rows = store.select(camera, st.SelectOptions(pixel_error=error, budget=2000)).rows
            slots.move(rows, camera.position)
            session.draw(camera, select=st.SelectOptions(budget=2000))


def convert_pieces(folder, name):
    st.convert(folder.with_name(f"{folder.stem}_tiles") / name, output / "out.ply", force=True)


def cluster(path):
    """With room for centres alone: what grows with the scene lies in files."""
    beside, Scratch.beside = Scratch.beside, lambda *_: Scratch(8e6, output)
    st.cluster_file(path, output / "clusters.splatree", 1024, force=True)
    Scratch.beside = beside


WORK = {
    "clusters of a folder": cluster,
    "clusters of a .ply": lambda folder: cluster(folder.with_suffix(".ply")),
    "convert from .glb": lambda folder: convert_pieces(folder, "a.glb"),
    "convert from 3D Tiles": lambda folder: convert_pieces(folder, "tileset.json"),
    "convert to .splatree": lambda folder: st.convert(folder, output / "out.splatree", force=True),
    "convert to .ply": lambda folder: st.convert(folder, output / "out.ply", force=True),
    "check": st.check,
    "info": lambda folder: describe(outline.read_outline([folder], ReadOptions())),
    "view": view,
    "read": lambda folder: st.read(folder),
}


def growth(work):
    """Memory beyond what there was before, at most."""
    before, peak, done = anonymous(), 0, threading.Event()

    def watch():
        nonlocal peak
        while not done.wait(0.0005):
            peak = max(peak, anonymous())

    watcher = threading.Thread(target=watch)
    watcher.start()
    kept = work()
    peak = max(peak, anonymous())
    done.set()
    watcher.join()
    del kept
    return peak - before


for work in WORK.values():
    work(small)
print(json.dumps({name: growth(lambda: work(large)) for name, work in WORK.items()}))
'''


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A small folder of parts and one of 60 MB."""
    path = tmp_path_factory.mktemp("memory")
    made = []
    for name, count in (("small", 3000), ("large", 160_000)):
        st.write(
            st.Scene.flat(
                cloud(count, 7, degree=3, log_scales=("normal", -5, 0.5), logits=("normal", 0.5, 1.0), sh=0.2)
            ),
            path / f"{name}.ply",
        )
        tiles = path / f"{name}_tiles"
        tiles.mkdir()
        st.convert(path / f"{name}.ply", tiles / "a.glb")
        matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5e5, 4e6, 100, 1]  # far away: an origin is looked for
        root = {"transform": matrix, "content": {"uri": "a.glb"}}
        (tiles / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, "root": root}))
        options = st.BuildOptions(radius=0.01, max_roots=4)
        made.append(
            st.build_folder(
                path / f"{name}.ply", path / f"{name}.splatree", options, st.FolderOptions(part_rows=5000)
            ).path
        )
    return made


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc is Linux's")
def test_what_goes_by_pages_needs_a_fraction_of_the_scene(folders, tmp_path):
    small, large = folders
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(small), str(large), str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    grown = json.loads(run.stdout)
    scene = st.read(large)
    num_bytes = scene.gaussians.nbytes + 13 * len(scene)
    assert num_bytes > 50e6
    # What was freed before is used again, so even reading the whole grows by less than the whole.
    assert grown.pop("read") > 0.6 * num_bytes
    for name, growth in grown.items():
        assert growth < 0.5 * num_bytes, (name, growth)
