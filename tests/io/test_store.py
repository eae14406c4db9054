import json

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, GaussianTree, Scene
from splatree.lod.blocks import with_blocks
from splatree.render.build import build_lod
from splatree.scene.scene import Source

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits


def tree_scene(n=7):
    """A root with two children, of which the first has two, and a second root."""
    tree = GaussianTree(
        np.array([5, 4, 3, 4, 5, 6, 7][:n], np.int32), np.array([0, 1, 2, 2, 1, 0, 0], np.uint8), np.ones(7, np.float32)
    )
    ids = np.array([3, 1, 4, 0, 5, 9, 2], np.uint32)
    source = Source(("/home/someone/city.ply",), "ply", {"credit": "Samuel Hiero, CC BY 4.0"})
    return Scene(random_gaussians(7, 2), tree, ids, mode="antialiased", threshold=0.01, source=source)


def test_round_trip_keeps_every_bit_and_field(tmp_path):
    scene = tree_scene()
    splatree.write(scene, tmp_path / "a.splatree")
    back = splatree.read(tmp_path / "a.splatree")
    assert all(same_bits(getattr(scene.gaussians, c), getattr(back.gaussians, c)) for c in COLUMNS)
    assert all(same_bits(getattr(scene.tree, c), getattr(back.tree, c)) for c in ("subtree_end", "depth", "extents"))
    assert back.ids is not None and same_bits(scene.ids, back.ids)
    assert (back.mode, back.threshold) == (scene.mode, scene.threshold)
    assert back.source.metadata["credit"] == "Samuel Hiero, CC BY 4.0"
    assert json.loads(back.source.metadata["origin"]) == {"format": "ply", "names": ["city.ply"]}
    assert b"someone" not in (tmp_path / "a.splatree").read_bytes()


def test_a_file_says_nothing_of_the_machine_that_wrote_it(tmp_path):
    splatree.write(tree_scene(), tmp_path / "a.splatree")
    content = (tmp_path / "a.splatree").read_bytes()
    assert b'"device"' not in content and b'"threshold"' in content


@pytest.mark.parametrize("n", [0, 1])
def test_tiny_scenes_round_trip(tmp_path, n):
    splatree.write(Scene.flat(random_gaussians(n, 1)), tmp_path / "a.splatree")
    back = splatree.read(tmp_path / "a.splatree")
    assert len(back) == n and back.gaussians.sh_degree == 1 and back.ids is None


def test_the_block_index_is_made_anew_for_a_scene_with_levels(tmp_path):
    scene = with_blocks(tree_scene())
    splatree.write(scene, tmp_path / "a.splatree")
    back = splatree.read(tmp_path / "a.splatree")
    assert b"blocks" not in (tmp_path / "a.splatree").read_bytes()
    assert back.blocks is not None and scene.blocks is not None
    for name in ("lower", "upper", "ancestors", "ancestor_start", "leaf_scales"):
        assert same_bits(getattr(back.blocks, name), getattr(scene.blocks, name))


def test_a_scene_that_was_read_can_be_built_again(tmp_path):
    """Its columns are read-only and it brings a block index, which is not that of the new tree."""
    splatree.write(tree_scene(), tmp_path / "a.splatree")
    again = build_lod(splatree.read(tmp_path / "a.splatree"))
    assert again.tree.num_leaves == 5 and len(again.blocks.size_classes) == len(again)


def test_the_columns_are_mapped_not_copied(tmp_path):
    splatree.write(tree_scene(), tmp_path / "a.splatree")
    g = splatree.read(tmp_path / "a.splatree").gaussians
    assert not any(getattr(g, c).flags.owndata or getattr(g, c).flags.writeable for c in COLUMNS)


def test_the_safetensors_library_reads_it(tmp_path):
    from safetensors.numpy import load_file

    scene = tree_scene()
    splatree.write(scene, tmp_path / "a.splatree")
    columns = load_file(tmp_path / "a.splatree")
    assert same_bits(columns["gaussians.sh"], scene.gaussians.sh) and same_bits(columns["ids"], scene.ids)


def test_a_file_of_the_safetensors_library_is_read(tmp_path):
    from safetensors.numpy import load_file, save_file

    splatree.write(tree_scene(), tmp_path / "a.splatree")
    columns = load_file(tmp_path / "a.splatree")
    metadata = {"format": "splatree", "version": "1", "mode": '"classic"', "threshold": "0.5", "source": "{}"}
    save_file(columns, tmp_path / "b.splatree", metadata)
    back = splatree.read(tmp_path / "b.splatree")
    assert same_bits(back.gaussians.means, columns["gaussians.means"]) and back.threshold == 0.5


def rewrite(path, change):
    """Change the header of a file, keeping its columns."""
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    change(header)
    text = json.dumps(header, separators=(",", ":")).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + size :])


def set_in(*keys, value):
    def change(header):
        for key in keys[:-1]:
            header = header[key]
        header[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_in("__metadata__", "version", value="3"), "newer splatree"),
        (set_in("__metadata__", "mode", value='"blurry"'), "wanted 'classic' or 'antialiased'"),
        (set_in("__metadata__", "mode", value="[1]"), "mode"),
        (set_in("__metadata__", "threshold", value='"x"'), "threshold: found 'x', wanted a number"),
        (set_in("__metadata__", "threshold", value="NaN"), "threshold"),
        (set_in("__metadata__", "source", value="[]"), "wanted an object"),
        (lambda h: h["__metadata__"].pop("threshold"), "no key 'threshold'"),
        (lambda h: h.pop("gaussians.means"), "behind the header"),
        (set_in("gaussians.means", "dtype", value="F16"), "found dtype 'F16'"),
        (set_in("gaussians.means", "dtype", value="I32"), "found dtype int32, wanted float32"),
        (set_in("gaussians.means", "shape", value=[3, 7]), "means"),
        (set_in("gaussians.means", "shape", value=[7, 2**40]), "whole number"),
        (set_in("gaussians.means", "shape", value=[-7, -3]), "whole number"),
        (set_in("gaussians.means", "data_offsets", value=[0, 2**60]), "cut off or damaged"),
        (set_in("gaussians.means", "data_offsets", value=[84]), "cut off or damaged"),
        (lambda h: h.update(ids2=h.pop("ids")), "unknown columns \\['ids2'\\]"),
    ],
)
def test_lying_headers_are_refused_with_a_reason(tmp_path, change, message):
    splatree.write(tree_scene(), tmp_path / "a.splatree")
    rewrite(tmp_path / "a.splatree", change)
    with pytest.raises(FormatError, match=message):
        splatree.read(tmp_path / "a.splatree")


@pytest.mark.parametrize("length", [0, 7, 8, 100, -1])
def test_cut_off_files_are_refused(tmp_path, length):
    splatree.write(tree_scene(), tmp_path / "a.splatree")
    (tmp_path / "a.splatree").write_bytes((tmp_path / "a.splatree").read_bytes()[:length])
    with pytest.raises(FormatError, match=r"a\.splatree"):
        splatree.read(tmp_path / "a.splatree")


def test_a_tree_that_is_none_is_refused(tmp_path):
    scene = tree_scene()
    splatree.write(scene, tmp_path / "a.splatree")
    data = (tmp_path / "a.splatree").read_bytes()
    good = scene.tree.subtree_end.tobytes()
    assert data.count(good) == 1
    (tmp_path / "a.splatree").write_bytes(data.replace(good, np.full(7, 99, np.int32).tobytes()))
    with pytest.raises(FormatError, match=r"a\.splatree.*subtree_end\[0\]: found 99"):
        splatree.read(tmp_path / "a.splatree")


@pytest.mark.parametrize("value", [np.nan, np.inf, -1])
def test_extents_that_cannot_be_are_refused(tmp_path, value):
    scene = tree_scene()
    extents = scene.tree.extents.copy()
    extents[4] = value
    tree = GaussianTree(scene.tree.subtree_end, scene.tree.depth, extents)
    splatree.write(Scene(scene.gaussians, tree), tmp_path / "a.splatree")
    with pytest.raises(FormatError, match=r"row 4, tree.extents"):
        splatree.read(tmp_path / "a.splatree")


def test_a_scene_with_levels_is_not_repaired(tmp_path):
    scene = tree_scene()
    g = scene.gaussians
    means = g.means.copy()
    means[3, 1] = np.nan
    bad = Scene(Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh), scene.tree)
    splatree.write(bad, tmp_path / "a.splatree")
    with pytest.raises(FormatError, match=r"row 3, means\[1\]: found nan.*build it again"):
        splatree.read(tmp_path / "a.splatree", repair=True)


def test_flat_formats_get_the_leaves_or_a_cut(tmp_path):
    scene = tree_scene()
    for depth, rows in ((None, [2, 3, 4, 5, 6]), (0, [0, 5, 6]), (1, [1, 4, 5, 6]), (2, [2, 3, 4, 5, 6])):
        splatree.write(scene, tmp_path / f"{depth}.ply", depth=depth)
        back = splatree.read(tmp_path / f"{depth}.ply")
        assert same_bits(back.gaussians.means, scene.gaussians.means[rows]) and back.mode == "antialiased"


def test_clusters_are_kept_but_their_radii_made_anew(tmp_path):
    scene = splatree.build_clusters(Scene.flat(random_gaussians(40, 3)), 6)
    splatree.write(scene, tmp_path / "a.splatree")
    back = splatree.read(tmp_path / "a.splatree")
    for name in ("start", "centers", "radii", "mean_radii", "footprint_radii", "box_low", "box_high"):
        assert same_bits(getattr(scene.clusters, name), getattr(back.clusters, name))
    assert json.loads(back.source.metadata["clusters"])["clusters"] == 6
    # A file that says its spheres are smaller would hide what reaches out of them.
    content = bytearray((tmp_path / "a.splatree").read_bytes())
    at = content.find(scene.clusters.footprint_radii.tobytes())
    content[at : at + 24] = (scene.clusters.footprint_radii * np.float32(1.5)).tobytes()
    (tmp_path / "b.splatree").write_bytes(content)
    assert same_bits(splatree.read(tmp_path / "b.splatree").clusters.footprint_radii, scene.clusters.footprint_radii)
    content[at : at + 24] = (scene.clusters.footprint_radii / 9).tobytes()
    (tmp_path / "c.splatree").write_bytes(content)
    with pytest.raises(FormatError, match="clusters of other Gaussians"):
        splatree.read(tmp_path / "c.splatree")


def test_clusters_of_a_file_without_boxes_get_them(tmp_path):
    scene = splatree.build_clusters(Scene.flat(random_gaussians(40, 3)), 6)
    splatree.write(scene, tmp_path / "a.splatree")
    content = (tmp_path / "a.splatree").read_bytes()
    size = int.from_bytes(content[:8], "little")
    header, body = json.loads(content[8 : 8 + size]), content[8 + size :]
    kept = {name: header.pop(name) for name in list(header) if name != "__metadata__"}
    columns = b""
    for name, entry in kept.items():
        if "box" not in name:
            begin, end = entry["data_offsets"]
            header[name] = entry | {"data_offsets": [len(columns), len(columns) + end - begin]}
            columns += body[begin:end]
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-(8 + len(text)) % 64)
    (tmp_path / "old.splatree").write_bytes(len(text).to_bytes(8, "little") + text + columns)
    back = splatree.read(tmp_path / "old.splatree")
    for name in ("box_low", "box_high"):
        assert f"clusters.{name}" in kept
        assert same_bits(getattr(scene.clusters, name), getattr(back.clusters, name))


def test_clusters_that_do_not_cover_the_rows_are_refused(tmp_path):
    scene = splatree.build_clusters(Scene.flat(random_gaussians(40, 3)), 6)
    splatree.write(scene, tmp_path / "a.splatree")
    content = (tmp_path / "a.splatree").read_bytes()
    start = scene.clusters.start
    for wrong in (start[::-1], start - 1, start * 0, start * 1000):
        (tmp_path / "b.splatree").write_bytes(content.replace(start.tobytes(), wrong.astype(np.int32).tobytes()))
        with pytest.raises(FormatError, match="clusters"):
            splatree.read(tmp_path / "b.splatree")
