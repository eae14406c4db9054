import hashlib
import json
import shutil
import zipfile

import numpy as np
import pytest

import splatree
from splatree import FormatError, InputError
from splatree.io.registry import stored_bytes

from .conftest import COLUMNS, same_bits
from .sog_files import bundle, webp, write_sog


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("bands", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [1, 21, 300])
def test_codes_become_the_values_that_the_format_defines(tmp_path, version, bands, n):
    codes = write_sog(tmp_path / "s", n=n, version=version, bands=bands, palette=130)
    g = splatree.read(tmp_path / "s").gaussians
    meta = codes["meta"]
    for row in (0, n // 2, n - 1):  # one by one, in the words of the format
        for axis in range(3):
            u = int(codes["means_l"][row, axis]) + 256 * int(codes["means_u"][row, axis])
            low, high = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
            m = low + (high - low) * u / 65535
            np.testing.assert_allclose(g.means[row, axis], np.sign(m) * (np.exp(abs(m)) - 1), rtol=1e-6, atol=1e-9)
            code = int(codes["scales"][row, axis])
            if version == 2:
                wanted = meta["scales"]["codebook"][code]
            else:
                low, high = meta["scales"]["mins"][axis], meta["scales"]["maxs"][axis]
                wanted = low + (high - low) * code / 255
            np.testing.assert_allclose(g.log_scales[row, axis], wanted, rtol=1e-6, atol=1e-7)
        largest = int(codes["quats"][row, 3]) - 252
        others = [i for i in range(4) if i != largest]
        wanted_others = (codes["quats"][row, :3] / 255 * 2 - 1) / np.sqrt(2)
        np.testing.assert_allclose(g.quats[row, others], wanted_others, atol=1e-7)
        np.testing.assert_allclose(np.linalg.norm(g.quats[row]), 1, atol=1e-6)
        assert g.quats[row, largest] >= 0
        alpha = int(codes["sh0"][row, 3])
        if version == 2 and 0 < alpha < 255:
            np.testing.assert_allclose(1 / (1 + np.exp(-g.logit_opacities[row])), alpha / 255, atol=1e-6)
        elif version == 1:
            np.testing.assert_allclose(g.logit_opacities[row], -5 + 10 * alpha / 255, atol=1e-6)
        if bands:
            wanted_rest = -1 + 2 * codes["centroids"][codes["labels"][row]] / 255
            np.testing.assert_allclose(g.sh[row, 1:], wanted_rest, atol=1e-6)
    assert g.sh_degree == bands


def test_opaque_and_invisible_have_finite_logits(tmp_path):
    codes = write_sog(tmp_path / "s", n=2, bands=0)
    codes["sh0"][:, 3] = (0, 255)
    webp(tmp_path / "s" / "sh0.webp", codes["sh0"].astype(np.uint8), 4)
    logits = splatree.read(tmp_path / "s").gaussians.logit_opacities
    np.testing.assert_allclose(logits, [-13.8155, 13.8155], atol=1e-3)


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_folder_meta_and_bundle_are_the_same_scene(tmp_path, compression):
    write_sog(tmp_path / "s")
    bundle(tmp_path / "s", tmp_path / "s.sog", compression=compression)
    bundle(tmp_path / "s", tmp_path / "no_suffix", compression=compression)
    wanted = splatree.read(tmp_path / "s").gaussians
    for path in ("s/meta.json", "s.sog", "no_suffix"):
        scene = splatree.read(tmp_path / path)
        assert scene.source.format == "sog"
        assert all(same_bits(getattr(scene.gaussians, c), getattr(wanted, c)) for c in COLUMNS)


@pytest.mark.parametrize(
    ("key", "value", "mode"), [("model", "antialiased", "antialiased"), ("model", "default", "classic")]
)
def test_the_mode_is_read(tmp_path, key, value, mode):
    meta = write_sog(tmp_path / "s")["meta"]
    (tmp_path / "s/meta.json").write_text(json.dumps({**meta, key: value}))
    assert splatree.read(tmp_path / "s").mode == mode


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (["count"], 22, None),  # padding of the picture holds it: the rows there are zeros, tag 0
        (["count"], 10**6, "wanted at least 1000000"),
        (["count"], 10**9, "decompression bomb"),
        (["count"], 10**12, "whole number"),
        (["count"], -1, "whole number"),
        (["count"], True, "whole number"),
        (["version"], 3, "version: found 3"),
        (["means", "mins"], [0, 0], r"shape \(2,\), wanted \(3,\)"),
        (["means", "mins"], [0, 0, None], "finite numbers|numbers only"),
        (["means", "maxs"], [0, 0, 1e9], "row .*, means"),
        (["scales", "codebook"], [0.0] * 255, r"wanted \(256,\)"),
        (["scales", "codebook"], [99.0] * 256, "log_scales"),
        (["quats", "files"], ["../s/quats.webp"], "inside the folder"),
        (["quats", "files"], ["/etc/passwd"], "inside the folder"),
        (["quats", "files"], ["missing.webp"], "meta.json names it"),
        (["quats", "files"], ["meta.json"], "not a whole WebP picture"),
        (["quats", "files"], [], "wanted 1 file names"),
        (["shN", "bands"], 2, "512 px at 2 bands"),
        (["shN", "bands"], 4, "whole number"),
        (["shN", "count"], 1000, "wanted at most the 128 entries"),
        (["shN", "count"], 3, "shN label"),
        (["shN"], "x", "wanted an object"),
        (["sh0"], None, "wanted an object"),
        (["model"], "2dgs", "found model '2dgs'"),
    ],
)
def test_lying_meta_is_refused_with_a_reason(tmp_path, keys, value, message):
    meta = write_sog(tmp_path / "s")["meta"]
    record = meta
    for key in keys[:-1]:
        record = record[key]
    record[keys[-1]] = value
    (tmp_path / "s/meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match=message or "found tag"):
        splatree.read(tmp_path / "s")


def test_a_damaged_tag_is_repaired_to_no_rotation_and_counted(tmp_path):
    codes = write_sog(tmp_path / "s")
    codes["quats"][4, 3] = 100
    webp(tmp_path / "s/quats.webp", codes["quats"].astype(np.uint8), 8)
    with pytest.raises(FormatError, match="row 4, quats: found tag 100"):
        splatree.read(tmp_path / "s")
    scene = splatree.read(tmp_path / "s", repair=True)
    np.testing.assert_array_equal(scene.gaussians.quats[4], [1, 0, 0, 0])
    assert json.loads(scene.source.metadata["repairs"]) == {"repaired_quaternions": 1}


def test_a_bundle_that_inflates_is_refused(tmp_path):
    write_sog(tmp_path / "s")
    (tmp_path / "s/means_l.webp").write_bytes(bytes(5_000_000))
    bundle(tmp_path / "s", tmp_path / "s.sog", compression=zipfile.ZIP_DEFLATED)
    with pytest.raises(FormatError, match="promises 5000000 bytes from a bundle"):
        splatree.read(tmp_path / "s.sog")


def test_a_picture_that_inflates_is_refused(tmp_path):
    write_sog(tmp_path / "s")
    webp(tmp_path / "s/scales.webp", np.zeros((4000 * 4000, 3), np.uint8), 4000)
    assert (tmp_path / "s/scales.webp").stat().st_size < 10_000
    with pytest.raises(FormatError, match=r"4000 × 4000 px in .* decompression bomb"):
        splatree.read(tmp_path / "s")


def test_a_bundle_of_the_folder_as_a_whole_is_read(tmp_path):
    write_sog(tmp_path / "s")
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as out:
        for file in (tmp_path / "s").iterdir():
            out.write(file, f"s/{file.name}")
        out.writestr("__MACOSX/s/._meta.json", "x")
    assert same_bits(splatree.read(tmp_path / "a.sog").gaussians.means, splatree.read(tmp_path / "s").gaussians.means)


def test_a_bundle_without_meta_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as out:
        out.writestr("other.txt", "x")
    with pytest.raises(FormatError, match=r"no entry 'meta\.json'"):
        splatree.read(tmp_path / "a.sog")


# Bit for bit what splat-transform 3.7.0 converts these to (.ply, compared column by column).
PEER = {
    "trained/semarang_city/5_9": (252_828, 3, "f63a3ebc6bb18f43"),
    "trained/playcanvas_logo": (307_128, 0, "0dcf452885cebcb0"),
    "trained/playbot/3_0": (31_000, 2, "0de53ffa10a82052"),
}


def digest(gaussians):
    return hashlib.sha256(b"".join(getattr(gaussians, c).tobytes() for c in COLUMNS)).hexdigest()[:16]


@pytest.mark.parametrize("name", PEER)
def test_real_scenes_decode_as_the_peer_does(data, name):
    count, degree, wanted = PEER[name]
    scene = splatree.read(data / name)
    assert (len(scene), scene.gaussians.sh_degree) == (count, degree)
    assert digest(scene.gaussians) == wanted


LEVELS = [500_000, 250_000, 125_000, 31_000, 8_406, 3_000, 1_873]


@pytest.mark.parametrize("level", range(7))
def test_every_level_of_a_streamed_scene(data, level):
    scene = splatree.read(data / "trained/playbot", level=level)
    assert len(scene) == LEVELS[level] and scene.gaussians.sh_degree == 2
    assert scene.source.format == "streamed-sog" and scene.source.metadata["level"] == str(level)


def streamed(folder, *, environment=False):
    """Two levels: 21 rows of one unit and 5 of another in two leaves; level 1 has rows in the second leaf alone."""
    for i, n in enumerate((30, 9, 4)):
        write_sog(folder / f"unit{i}", n=n, seed=i)

    def box(lods):
        return {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}, "lods": lods}

    leaves = [
        box({"0": {"file": 0, "offset": 10, "count": 20}}),
        box({"0": {"file": 0, "offset": 0, "count": 10}, "1": {"file": 1, "offset": 2, "count": 5}}),
    ]
    meta = {
        "version": 1,
        "lodLevels": 2,
        "counts": [30, 5],
        "environment": "unit2/meta.json" if environment else None,
        "filenames": ["unit0/meta.json", "unit1/meta.json"],
        "tree": {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}, "children": leaves},
    }
    (folder / "lod-meta.json").write_text(json.dumps(meta))
    return meta


def test_a_level_is_its_ranges_in_the_order_of_the_tree(tmp_path):
    streamed(tmp_path)
    units = [splatree.read(tmp_path / f"unit{i}").gaussians for i in range(2)]
    finest = splatree.read(tmp_path).gaussians
    assert same_bits(finest.means, units[0].means[[*range(10, 30), *range(10)]])
    coarse = splatree.read(tmp_path / "lod-meta.json", level=1).gaussians
    assert same_bits(coarse.sh, units[1].sh[2:7].copy())


def test_all_levels_are_read_and_counted(tmp_path):
    streamed(tmp_path)
    levels = splatree.read_levels(tmp_path)
    assert [len(level) for level in levels] == [30, 5]
    assert json.loads(levels[0].source.metadata["level_counts"]) == [30, 5]
    assert splatree.link_levels(levels).tree.num_leaves == 30
    with pytest.raises(InputError, match="no levels to choose from"):
        splatree.read_levels(tmp_path / "unit0")


def test_the_environment_belongs_to_every_level(tmp_path):
    streamed(tmp_path, environment=True)
    far = splatree.read(tmp_path / "unit2").gaussians
    for level, n in ((0, 30), (1, 5)):
        scene = splatree.read(tmp_path, level=level)
        assert len(scene) == n + 4 and same_bits(scene.gaussians.means[n:].copy(), far.means)


def test_units_of_different_degrees_make_a_level_of_the_highest(tmp_path):
    streamed(tmp_path, environment=True)
    shutil.rmtree(tmp_path / "unit2")
    write_sog(tmp_path / "unit2", n=4, bands=2)
    near, far, level = (splatree.read(tmp_path / name).gaussians.sh for name in ("unit0", "unit2", "."))
    assert level.shape == (34, 9, 3) and same_bits(level[30:].copy(), far)
    assert same_bits(level[:20, :4].copy(), near[10:].copy()) and not level[:30, 4:].any()


def test_a_bad_value_is_told_by_its_row_of_the_level(tmp_path):
    """Row 3 of unit 0 is row 23 of the level: 20 rows of another leaf come first."""
    streamed(tmp_path)
    shutil.rmtree(tmp_path / "unit0")
    written = write_sog(tmp_path / "unit0", n=30)
    codes, meta = written["scales"], written["meta"]
    lonely = next(c for c in codes[3] if (codes == c).sum() == 1)
    meta["scales"]["codebook"][int(lonely)] = 1e6
    (tmp_path / "unit0/meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match="row 23, log_scales"):
        splatree.read(tmp_path)


def test_the_bytes_of_a_streamed_scene_are_those_of_the_files_it_names(tmp_path):
    streamed(tmp_path, environment=True)
    every_file = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    (tmp_path / "notes.txt").write_text("not of the scene")
    assert stored_bytes(tmp_path) == stored_bytes(tmp_path / "lod-meta.json") == every_file
    unit = tmp_path / "unit0"
    assert stored_bytes(unit) == stored_bytes(unit / "meta.json") == sum(p.stat().st_size for p in unit.iterdir())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(version=2), "version: found 2"),
        (lambda m: m.update(lodLevels=0), "lodLevels"),
        (lambda m: m.update(counts=[30]), "found 1 counts"),
        (lambda m: m.update(counts=[29, 5]), "ranges of 30 rows in its tree, wanted 29"),
        (lambda m: m.update(filenames=["../x", "y"]), "inside the folder"),
        (lambda m: m.update(filenames=["gone/meta.json", "unit1/meta.json"]), "fetch the whole folder"),
        (lambda m: m.update(tree=[]), "wanted an object"),
        (lambda m: m["tree"]["children"].append(7), "a node of the tree: found a number"),
        (lambda m: m["tree"]["children"][0]["lods"]["0"].update(offset=5), "overlap"),
        (lambda m: m["tree"]["children"][0]["lods"]["0"].update(offset=9), "overlap"),  # by one row
        (lambda m: m["tree"]["children"][0]["lods"]["0"].update(offset=11), "wanted at most its 30"),
        (lambda m: m["tree"]["children"][0]["lods"]["0"].update(file=2), "file: found 2"),
    ],
)
def test_lying_manifests_are_refused_with_a_reason(tmp_path, change, message):
    meta = streamed(tmp_path)
    change(meta)
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match=message):
        splatree.read(tmp_path)


def test_a_tree_may_be_200_deep_and_no_deeper(tmp_path):
    meta = streamed(tmp_path)
    whole = splatree.read(tmp_path)
    children = meta["tree"]["children"]
    for _ in range(199):  # the leaves are one below
        children = [{"children": children}]
    meta["tree"]["children"] = children
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    assert same_bits(splatree.read(tmp_path).gaussians.means, whole.gaussians.means)
    meta["tree"] = {"children": [meta["tree"]]}
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    with pytest.raises(FormatError, match="found a tree of more than 200 levels"):
        splatree.read(tmp_path)


def test_a_level_that_is_not_there_is_refused(tmp_path):
    streamed(tmp_path)
    for level in (-1, 2):
        with pytest.raises(InputError, match=f"found level {level}, wanted 0"):
            splatree.read(tmp_path, level=level)
    with pytest.raises(InputError, match="no levels to choose"):
        splatree.read(tmp_path / "unit0", level=0)
