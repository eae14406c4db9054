"""Files changed at random are read as a valid scene or refused by one of our errors; nothing else may happen.

A change sets bytes, cuts the file off, or puts bytes in, mostly in the head where the structure is. Every format that is written
is changed as we write it, of real Gaussians, and the files of other writers in the shared data as they are. What is accepted must
hold values that can be drawn, in chunks the same as whole; memory must stay within a small multiple of the file. Warnings are
errors here, so a silent overflow fails as well.
"""

import json
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import splatree
from splatree import GaussianTree, ReadOptions, Scene, SplatreeError, WriteOptions
from splatree.io.check import checked
from splatree.io.registry import Format, detect, formats

from ..scenes import random_gaussians
from .conftest import DATA
from .sog_files import bundle, write_sog
from .test_cameras import POSES, transforms, write_colmap
from .test_hier import DEPTHS, forest

EXAMPLES = settings(max_examples=60)
BUNDLED = Path(splatree.__file__).parent / "data" / "semarang_5_9.sog"
GLTF = ("a.glb", "packed.glb")
LEVELS = ["0.ksplat", "2.ksplat", "0.hier", "1.hier", "0.rad", "2.rad"]
"""Files of a tree, or of its leaves; the number is the level of compression."""
WRITTEN = [f.suffixes[0] for f in formats() if f.is_written and f.suffixes]


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """One small file or folder of each kind."""
    root = tmp_path_factory.mktemp("originals")
    scene = Scene.flat(random_gaussians(12, 1))
    for name in ("a.ply", "a.compressed.ply", "a.splat"):
        splatree.write(scene, root / name)
    tree = GaussianTree(np.array([3, 2, 3], np.int32), np.array([0, 1, 1], np.uint8), np.ones(3, np.float32))
    splatree.write(Scene(random_gaussians(3, 0), tree), root / "a.splatree")
    write_sog(root / "v1", n=9, version=1)
    write_sog(root / "v2", n=9, version=2)
    bundle(root / "v2", root / "a.sog")
    splatree.write(scene, root / "a.glb")
    splatree.write(scene, root / "packed.glb", options=WriteOptions(packing="spz"))
    for version in (2, 3, 4):
        splatree.write(scene, root / f"v{version}.spz", options=WriteOptions(format_version=version))
    for name in LEVELS:
        splatree.write(forest(DEPTHS["several roots"], 1), root / name, options=WriteOptions(compression=int(name[0])))
    write_colmap(root / "bin", binary=True)
    write_colmap(root / "txt", binary=False)
    splatree.write_cameras(POSES, root / "cameras.json")
    (root / "transforms.json").write_text(json.dumps(transforms(k1=0.0)))
    return root


@st.composite
def changes(draw):
    """A list of (kind, share of the file, bytes)."""
    place = st.one_of(st.floats(0, 1), st.floats(0, 0.05), st.floats(0.95, 1))
    raw = st.one_of(
        st.binary(min_size=1, max_size=8),
        st.sampled_from(
            [
                b"\x00" * 8,
                b"\xff" * 8,
                b"\x00\x00\xc0\x7f",
                b"\x00\x00\xa0\x7f",
                b"999999999999",
                b"-1",
                b"1e999",
                b"NaN",
                b"{",
                b"]",
            ]
        ),
    )
    return draw(st.lists(st.tuples(st.sampled_from(["set", "cut", "insert"]), place, raw), min_size=1, max_size=4))


def changed(data: bytes, edits) -> bytes:
    for kind, share, raw in edits:
        at = int(share * len(data))
        if kind == "set":
            data = data[:at] + raw + data[at + len(raw) :]
        elif kind == "cut":
            data = data[:at] if len(raw) > 4 else data[:at] + data[at + len(raw) :]
        else:
            data = data[:at] + raw + data[at:]
    return data


def read_any(path: Path, repair: bool) -> None:
    try:
        scene = splatree.read(path, repair=repair)
    except SplatreeError as error:
        assert str(error)
        scene = None
    else:
        checked(scene, "accepted", repair=False)
        assert np.isfinite(scene.tree.extents).all()
    try:
        found = detect(path)
    except SplatreeError:  # an empty file, or what a server sent in the place of one
        assert scene is None
        return
    if found is not None and found.read_chunks is not None:
        check_chunks(found, path, repair, scene)


def check_chunks(found: Format, path: Path, repair: bool, scene: Scene | None) -> None:
    """In chunks a file is refused, or holds what it holds whole."""
    try:
        chunks = found.read_chunks(path, ReadOptions(repair=repair))
        if chunks is None:  # a file with levels
            return
        sh = [part.sh.copy() for part in chunks]
    except SplatreeError:
        assert scene is None
    else:
        assert scene is not None and b"".join(map(np.ndarray.tobytes, sh)) == scene.gaussians.sh.tobytes()


@pytest.fixture(scope="module")
def real_files(tmp_path_factory):
    """Thirty Gaussians of the bundled city in each format that is written."""
    root = tmp_path_factory.mktemp("real")
    scene = splatree.read(BUNDLED)
    few = Scene.flat(scene.gaussians.take(np.arange(0, len(scene), len(scene) // 30)))
    for suffix in WRITTEN:
        splatree.write(few, root / f"real{suffix}")
    return root


@pytest.mark.parametrize("suffix", WRITTEN)
@given(edits=changes(), repair=st.booleans())
@settings(max_examples=30)
def test_changed_real_files_are_refused_or_valid(real_files, suffix, edits, repair):
    changed_file = real_files / f"changed{suffix}"
    changed_file.write_bytes(changed((real_files / f"real{suffix}").read_bytes(), edits))
    read_any(changed_file, repair)


SHARED = [
    "biker.compressed.ply",
    "biker_v4.spz",
    *(f"semarang_block/block{end}" for end in (".compressed.ply", ".glb", "_v3.spz", "_v4.spz", "_inria.ply")),
    *(f"semarang_block/block_c{level}.ksplat" for level in range(3)),
]


@pytest.mark.parametrize("name", SHARED)
@given(edits=changes(), repair=st.booleans())
@settings(max_examples=6)
def test_changed_files_of_other_writers_are_refused_or_valid_within_memory(tmp_path_factory, name, edits, repair):
    path = DATA / "formats" / name
    if not path.exists():
        pytest.skip("needs the real scenes of ../shared/data")
    if detect(path) is None:
        pytest.skip(f"no format of {name} is known")
    changed_file = tmp_path_factory.mktemp("changed") / Path(name).name
    changed_file.write_bytes(changed(path.read_bytes(), edits))
    tracemalloc.start()
    try:
        try:
            splatree.read(changed_file, repair=repair)
        except SplatreeError as error:
            assert str(error)
        # The most compact is the .spz, 18 times smaller than its columns; a checked or repaired copy of them beside.
        assert tracemalloc.get_traced_memory()[1] < 50 * changed_file.stat().st_size + 10_000_000
    finally:
        tracemalloc.stop()
        changed_file.unlink()


@pytest.mark.parametrize(
    "name",
    ["a.ply", "a.compressed.ply", "a.splat", "a.splatree", "a.sog", "v2.spz", "v3.spz", "v4.spz", *GLTF, *LEVELS],
)
@given(edits=changes(), repair=st.booleans())
@EXAMPLES
def test_changed_files_are_refused_or_valid(originals, name, edits, repair):
    changed_file = originals / f"changed_{name}"
    changed_file.write_bytes(changed((originals / name).read_bytes(), edits))
    read_any(changed_file, repair)


@pytest.mark.parametrize("folder", ["v1", "v2"])
@pytest.mark.parametrize("name", ["meta.json", "means_l.webp", "quats.webp", "centroids.webp", "labels.webp"])
@given(edits=changes(), repair=st.booleans())
@settings(max_examples=12)
def test_changed_parts_of_a_folder_are_refused_or_valid(originals, folder, name, edits, repair):
    copy = originals / f"changed_{folder}"
    if not copy.exists():
        shutil.copytree(originals / folder, copy)
    whole = (originals / folder / name).read_bytes()
    (copy / name).write_bytes(changed(whole, edits))
    read_any(copy, repair)
    (copy / name).write_bytes(whole)


@pytest.mark.parametrize(
    "name",
    ["bin/cameras.bin", "bin/images.bin", "txt/cameras.txt", "txt/images.txt", "cameras.json", "transforms.json"],
)
@given(edits=changes())
@EXAMPLES
def test_changed_cameras_are_refused_or_valid(originals, name, edits):
    path = originals / name
    whole = path.read_bytes()
    path.write_bytes(changed(whole, edits))
    try:
        splatree.read_cameras(path if path.suffix == ".json" else path.parent)  # what is accepted, Camera has checked
    except SplatreeError as error:
        assert str(error)
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("lie", ["ply", "sog", "splatree"])
def test_a_lying_count_allocates_no_more_than_a_few_times_the_file(originals, tmp_path, lie):
    if lie == "ply":
        path = tmp_path / "a.ply"
        path.write_bytes((originals / "a.ply").read_bytes().replace(b"vertex 12\n", b"vertex 400000000\n"))
    elif lie == "sog":
        path = tmp_path / "s"
        shutil.copytree(originals / "v2", path)
        text = (path / "meta.json").read_text()
        (path / "meta.json").write_text(text.replace('"count": 9', '"count": 400000000'))
    else:
        path = tmp_path / "a.splatree"
        path.write_bytes((originals / "a.splatree").read_bytes().replace(b'"shape":[3,3]', b'"shape":[3,3000000000]'))
    tracemalloc.start()
    try:
        with pytest.raises(SplatreeError):
            splatree.read(path)
        assert (
            tracemalloc.get_traced_memory()[1] < 10_000_000
        )  # the tables of means alone take 3 MB; 400 M rows would 94 GB
    finally:
        tracemalloc.stop()
