import bz2
import gzip
import json
import lzma
import os
import resource
import shutil
import sys
import zipfile

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, GaussianTree, InputError, OutputError, Scene, WriteOptions
from splatree.io.chunks import Chunks, chunks_of
from splatree.io.joined import joined
from splatree.io.registry import detect, formats
from splatree.io.replacing import replacing
from splatree.progress import listen
from splatree.scene.scene import Source

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits
from .sog_files import write_sog


def write_scene(path, n=3, seed=0, **fields):
    path.parent.mkdir(parents=True, exist_ok=True)
    splatree.write(Scene.flat(random_gaussians(n, 1, seed), **fields), path)
    return path


def test_each_written_format_reads_back_from_any_name(tmp_path):
    """By content; `.splat` alone has no mark and needs its suffix."""
    for f in formats():
        if not f.is_written:
            continue
        path = write_scene(tmp_path / f"a{f.suffixes[0]}")
        assert splatree.read(path).source.format == f.name
        if f.name != "splat":
            shutil.copy(path, tmp_path / "renamed.dat")
            assert splatree.read(tmp_path / "renamed.dat").source.format == f.name


@pytest.mark.parametrize("f", [f for f in formats() if f.name in ("splatree", "ply", "splat")], ids=lambda f: f.name)
def test_formats_that_hold_floats_check_the_values_they_read(tmp_path, f):
    g = random_gaussians(5, 1)
    path = tmp_path / f"a{f.suffixes[0]}"
    splatree.write(Scene.flat(g), path)
    data = path.read_bytes()
    for row in range(5):
        z = g.means[row, 2].tobytes()
        assert data.count(z) == 1
        path.write_bytes(data.replace(z, np.float32(np.nan).tobytes()))
        with pytest.raises(FormatError, match=r"row \d, means\[2\]: found nan"):
            splatree.read(path)


@pytest.mark.parametrize("f", [f for f in formats() if f.is_written and f.holds.lossless], ids=lambda f: f.name)
def test_lossless_formats_are(tmp_path, f):
    g = random_gaussians(40, 3)
    splatree.write(Scene.flat(g), tmp_path / f"a{f.suffixes[0]}")
    back = splatree.read(tmp_path / f"a{f.suffixes[0]}").gaussians
    assert all(same_bits(getattr(g, c), getattr(back, c)) for c in COLUMNS)


def test_content_wins_over_the_suffix(tmp_path):
    path = write_scene(tmp_path / "a.ply").rename(tmp_path / "a.splat")
    assert splatree.read(path).source.format == "ply"


def test_several_inputs_are_one_scene_in_their_order(tmp_path):
    paths = [write_scene(tmp_path / f"{i}.ply", n=i + 1, seed=i) for i in range(3)]
    scene = splatree.read(paths[::-1])
    parts = [splatree.read(p).gaussians.means for p in paths[::-1]]
    assert same_bits(scene.gaussians.means, np.concatenate(parts))
    assert scene.source.paths == tuple(str(p) for p in paths[::-1]) and scene.tree.num_leaves == 6


def test_inputs_of_other_degrees_are_raised_to_the_highest(tmp_path):
    splatree.write(Scene.flat(random_gaussians(2, 0)), tmp_path / "a.ply")
    splatree.write(Scene.flat(random_gaussians(2, 3)), tmp_path / "b.ply")
    sh = splatree.read([tmp_path / "a.ply", tmp_path / "b.ply"]).gaussians.sh
    assert sh.shape == (4, 16, 3) and not sh[:2, 1:].any() and sh[2:, 1:].any()


def test_inputs_of_different_modes_are_not_joined(tmp_path):
    write_scene(tmp_path / "a.ply")
    write_scene(tmp_path / "b.ply", mode="antialiased")
    with pytest.raises(InputError, match="differ in their mode"):
        splatree.read([tmp_path / "a.ply", tmp_path / "b.ply"])


def test_a_folder_of_chunks_is_one_scene_in_natural_order(tmp_path):
    for i in (10, 9, 1):
        write_sog(tmp_path / f"chunk_{i}", n=i, seed=i)
    (tmp_path / "license.txt").write_text("CC BY 4.0")
    scene = splatree.read(tmp_path)
    assert len(scene) == 20
    assert [p.rsplit("_", 1)[1] for p in scene.source.paths] == ["1", "9", "10"]


def test_a_pattern_that_no_shell_expanded_is_expanded(tmp_path):
    for i in range(3):
        write_scene(tmp_path / f"part{i}.ply", n=i + 1)
    assert len(splatree.read(tmp_path / "part*.ply")) == 6
    assert len(splatree.read(str(tmp_path / "part[12].ply"))) == 5


def test_a_pattern_of_folders_reads_what_is_in_them(tmp_path):
    for i in range(3):
        write_scene(tmp_path / f"part_{i}/point_cloud.ply", n=i + 1)
    assert len(splatree.read(tmp_path / "part_*")) == 6


def test_the_newest_iteration_of_a_training_is_read(tmp_path):
    for i in (7000, 30000, 900):
        write_scene(tmp_path / f"point_cloud/iteration_{i}/point_cloud.ply", n=i // 100)
    (tmp_path / "input.ply").write_text("ply\nof points")
    assert len(splatree.read(tmp_path)) == len(splatree.read(tmp_path / "point_cloud")) == 300


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gone.ply", "not found"),
        ("gone*.ply", "no file matches"),
        ("empty", "found no scene in this folder"),
        ("text.txt", "of no known format"),
        ("zero.dat", "is empty"),
        ("zero.ply", "is empty"),
        ("zero.splatree", "is empty"),
        ("zero.sog", "is empty"),
        ("zeros.splatree", "a header of 0 bytes in a file of 4096"),
    ],
)
def test_what_is_no_scene_is_refused_with_a_reason(tmp_path, name, message):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("hello")
    for suffix in ("dat", "ply", "splatree", "sog"):
        (tmp_path / f"zero.{suffix}").write_bytes(b"")
    (tmp_path / "zeros.splatree").write_bytes(bytes(4096))
    with pytest.raises(InputError, match=message):
        splatree.read(tmp_path / name)


@pytest.mark.parametrize("name", ["chkpnt30000.pth", "ckpt_29999_rank0.pt", "model.bin", "old.dat"])
def test_checkpoints_are_named_and_never_unpickled(tmp_path, name):
    """Whatever they are called: by their suffix, as a ZIP of torch.save, or by the first bytes of a pickle."""
    path, ran = tmp_path / name, tmp_path / "ran"
    evil = b"\x80\x04cposix\nsystem\n(S'touch %s'\ntR." % os.fsencode(ran)
    if name == "old.dat":
        path.write_bytes(evil)
    else:
        with zipfile.ZipFile(path, "w") as bundle:
            bundle.writestr("archive/data.pkl", evil)
    with pytest.raises(InputError, match=r"is a pickled checkpoint .* export a \.ply"):
        splatree.read(path)
    assert not ran.exists()


def test_an_empty_splat_file_is_an_empty_scene(tmp_path):
    (tmp_path / "a.splat").write_bytes(b"")
    scene = splatree.read(tmp_path / "a.splat")
    assert len(scene) == 0
    assert "a.splat is empty" in scene.source.metadata["notes"]


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.ply")
    with pytest.raises(InputError, match="of no known format"):
        splatree.read(tmp_path / "a.ply")


def test_no_input_at_all_is_refused():
    with pytest.raises(InputError, match="wanted at least one"):
        splatree.read([])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_refused(tmp_path):
    path = write_scene(tmp_path / "a.ply")
    path.chmod(0)
    with pytest.raises(InputError, match="cannot be read"):
        splatree.read(path)


def test_detect_of_a_folder_and_of_nothing(tmp_path):
    write_sog(tmp_path / "s")
    assert detect(tmp_path / "s").name == "sog" and detect(tmp_path) is None


def test_an_existing_file_is_kept_unless_forced(tmp_path):
    path = write_scene(tmp_path / "a.ply")
    old = path.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        write_scene(path, n=9)
    assert path.read_bytes() == old
    splatree.write(Scene.flat(random_gaussians(9)), path, force=True)
    assert len(splatree.read(path)) == 9


@pytest.mark.parametrize(
    ("name", "message"), [("a.xyz", "wanted one of .splatree .compressed.ply .ply"), ("a", "suffix")]
)
def test_an_unknown_suffix_is_refused(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        splatree.write(Scene.flat(random_gaussians(1)), tmp_path / name)


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".splatree"])
def test_a_full_disk_leaves_the_old_file_whole_and_nothing_beside_it(tmp_path, suffix):
    path = write_scene(tmp_path / f"a{suffix}")
    old = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    big = Scene.flat(random_gaussians(3000))
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))  # as a full disk, a write stops half-way
    try:
        with pytest.raises(OutputError, match="could not be written"):
            splatree.write(big, path, force=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == old and [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("there", [True, False])
def test_a_full_disk_leaves_no_pictures_of_a_folder(tmp_path, there):
    if there:
        write_scene(tmp_path / "sog" / "meta.json")
    old = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, hard))  # enough for the first pictures alone
    try:
        with pytest.raises(OutputError, match="could not be written"):
            splatree.write(Scene.flat(random_gaussians(3000)), tmp_path / "sog" / "meta.json", force=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == old
    assert (tmp_path / "sog").exists() == there


@pytest.mark.skipif(sys.platform != "linux", reason="looks for the message of Linux")
def test_a_name_that_no_file_can_have_is_an_error_of_its_own(tmp_path):
    name = "x" * 300 + ".ply"  # 255 bytes are the most, as for a file that may not be looked at: neither is "not found"
    with pytest.raises(InputError, match=r"cannot be read \(File name too long\)"):
        splatree.read(tmp_path / name)
    with pytest.raises(OutputError, match="cannot be written"):
        splatree.write(Scene.flat(random_gaussians(1)), tmp_path / name)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, MemoryError])
def test_any_interruption_leaves_the_old_file_whole(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(error), replacing(tmp_path / "a.txt", force=True) as temporary:
        temporary.write_text("half")
        raise error
    assert (tmp_path / "a.txt").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("f", [f for f in formats() if f.is_written], ids=lambda f: f.name)
def test_progress_of_a_writer_names_the_new_file(tmp_path, f):
    events = []
    with listen(events.append):
        splatree.write(Scene.flat(random_gaussians(3)), tmp_path / f"new{f.suffixes[0]}")
    assert events
    assert [event.name for event in events if "tmp" in event.name] == []


def test_an_error_of_a_writer_names_the_new_file(tmp_path):
    g = random_gaussians(3)
    g.means[0] = 1e9
    with pytest.raises(InputError, match=f"^{tmp_path}/far.spz: found a mean"):
        splatree.write(Scene.flat(g), tmp_path / "far.spz")


def test_a_missing_folder_and_a_device_are_refused(tmp_path):
    scene = Scene.flat(random_gaussians(1))
    with pytest.raises(OutputError, match="there is no folder"):
        splatree.write(scene, tmp_path / "gone" / "a.ply")
    (tmp_path / "b.ply").mkdir()
    with pytest.raises(OutputError, match="not a plain file"):
        splatree.write(scene, tmp_path / "b.ply", force=True)
    os.mkfifo(tmp_path / "c.ply")
    with pytest.raises(OutputError, match="not a plain file"):
        splatree.write(scene, tmp_path / "c.ply", force=True)


def test_a_link_is_followed_when_its_target_is_replaced(tmp_path):
    path = write_scene(tmp_path / "a.ply")
    (tmp_path / "link.ply").symlink_to(path)
    splatree.write(Scene.flat(random_gaussians(8)), tmp_path / "link.ply", force=True)
    assert (tmp_path / "link.ply").is_symlink() and len(splatree.read(path)) == 8


def test_a_mapped_scene_can_be_written_over_its_own_file(tmp_path):
    path = write_scene(tmp_path / "a.splatree", n=50)
    scene = splatree.read(path)
    splatree.write(scene, path, force=True)
    assert same_bits(splatree.read(path).gaussians.sh, scene.gaussians.sh)


def test_metadata_of_joined_scenes(tmp_path):
    for i, names in enumerate((["label"], ["mask"])):
        path = write_scene(tmp_path / f"{i}.ply", n=1)
        data = path.read_bytes().replace(b"property float nx", b"property float " + names[0].encode())
        path.write_bytes(data)
    found = splatree.read(tmp_path).source.metadata["extra_properties"]
    assert [json.loads(x) for x in json.loads(found)] == [["label"], ["mask"]]


def tree_of_two() -> GaussianTree:
    return GaussianTree(np.array([3, 2, 3], np.int32), np.array([0, 1, 1], np.uint8), np.full(3, 1e6, np.float32))


def test_writing_says_what_is_lost(tmp_path):
    scene = Scene(random_gaussians(3, 2), tree_of_two(), mode="antialiased", threshold=0.5)
    assert splatree.write(scene, tmp_path / "a.splatree") == ()
    levels, threshold = splatree.write(scene, tmp_path / "a.ply")
    assert levels.startswith("the levels of detail, 1 merged nodes") and threshold.startswith("the threshold τ = 0.5")
    lost = splatree.write(scene, tmp_path / "a.splat", depth=0)  # one level was asked for: the others are not lost
    assert [sentence.split(":")[0] for sentence in lost] == [
        "the harmonics of degrees 1 to 2",
        "the mode antialiased",
        "the threshold τ = 0.5",
        "precision",
    ]
    assert splatree.write(Scene.flat(random_gaussians(3, 2)), tmp_path / "b.ply") == ()


def test_options_that_the_format_does_not_take_are_refused(tmp_path):
    scene = Scene.flat(random_gaussians(1))
    with pytest.raises(InputError, match=r"option sh_bits = 4, but this format takes none"):
        splatree.write(scene, tmp_path / "a.ply", options=WriteOptions(sh_bits=4))
    assert not list(tmp_path.iterdir())


def test_writing_says_that_clusters_are_lost(tmp_path):
    scene = splatree.build_clusters(Scene.flat(random_gaussians(20)), 4)
    assert splatree.write(scene, tmp_path / "a.splatree") == ()
    sentence = "the 4 clusters: the file gets none"
    assert splatree.write(scene, tmp_path / "a.ply") == (sentence,)
    assert sentence in splatree.write(scene, tmp_path / "a.rad")
    tree = splatree.build_clusters(splatree.build_lod(Scene.flat(random_gaussians(500))), 4)
    assert tree.tree.num_levels > 1
    (lost,) = splatree.write(tree, tmp_path / "b.splatree", depth=0)
    assert lost.endswith("clusters: the file gets none")


def test_what_readers_lost_is_kept_once_in_joined_scenes():
    def scene(lost):
        return Scene.flat(random_gaussians(1), source=Source(metadata={"lost": json.dumps(lost)}))

    both = joined([scene(["a", "b"]), scene(["b", "c"])])
    assert json.loads(both.source.metadata["lost"]) == ["a", "b", "c"]


def test_chunks_hold_all_rows_as_often_as_asked():
    g = random_gaussians(10, 1)
    chunks = chunks_of(Scene.flat(g), rows=4)
    for _ in range(2):
        assert [len(part) for part in chunks] == [4, 4, 2]
        assert same_bits(Gaussians.concatenate(list(chunks)).sh, g.sh)


def test_chunks_that_do_not_keep_their_promise_are_refused():
    parts = [random_gaussians(3, 1)]
    with pytest.raises(InputError, match="found 3 Gaussians, wanted 4"):
        list(Chunks(4, 1, "classic", lambda: iter(parts)))
    with pytest.raises(InputError, match="degree 1, wanted 0"):
        list(Chunks(3, 0, "classic", lambda: iter(parts)))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.jpg", b"\xff\xd8\xff\xe0", "is a picture, not a scene; train a scene from photographs"),
        ("a", b"\x89PNG\r\n\x1a\n", "is a picture, not a scene"),
        ("a.LAS", b"LASF", "is a point cloud or a mesh, which holds no Gaussians; train a scene"),
        ("a.obj", b"v 0 0 0\n", "is a point cloud or a mesh"),
        ("photos/a.JPG", b"\xff\xd8\xff", "photos: holds photographs or their cameras, not a scene; train a scene"),
        ("set/images/a.txt", b"", "set: holds photographs or their cameras"),
        ("set/transforms.json", b"{}", "set: holds photographs or their cameras"),
        ("set/notes.txt", b"x", "set: found no scene in this folder"),
        ("a.webp", b"RIFF0000WEBPVP8 ", "is a picture, not a scene"),
        ("a.heic", b"\0\0\0 ftypheic", "is a picture, not a scene"),
        ("a.mp4", b"\0\0\0 ftypisom", "is a video, not a scene; take pictures out of it"),
        ("a.avi", b"RIFF0000AVI LIST", "is a video, not a scene"),
        ("a.ply.bz2", bz2.compress(b"ply"), "is packed as bzip2, which is not read; unpack it with `bunzip2`"),
        ("a.ply", lzma.compress(b"ply"), "is packed as xz"),
        ("a.7z", b"7z\xbc\xaf\x27\x1c\0\4", "is packed as 7z"),
        ("a.tar", b"a.ply".ljust(257, b"\0") + b"ustar\0", "is a tar archive"),
        ("a.tar.gz", gzip.compress(b"a.ply".ljust(257, b"\0") + b"ustar\0", mtime=0), r"a.tar.gz: is a tar archive"),
        ("a.splatv", b"\x76\x84", "is a moving scene of antimatter15's viewer"),
        ("city/meta.lcc", b"{}", "city: is a scene of XGRIDS .LCC., which is not read; `splat-transform"),
        ("meta.lcc", b"{}", "is a scene of XGRIDS"),
    ],
)
def test_what_a_scene_is_trained_from_is_told_from_a_scene(tmp_path, name, content, message):
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        splatree.read(tmp_path / name.split("/")[0])
