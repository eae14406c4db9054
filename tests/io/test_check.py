import dataclasses
import json

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, GaussianTree, Scene
from splatree.io.check import LOGIT_CERTAIN, LOGIT_FROM_BYTE, checked, refuse_unusable
from splatree.io.notes import repairs_in, repairs_in_words

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits


def spoiled(column, index, value, n=9):
    """Nine good Gaussians with one bad value."""
    g = random_gaussians(n, 1)
    array = getattr(g, column).copy()
    array[index] = value
    return dataclasses.replace(g, **{column: array})


BAD = [
    ("means", (4, 1), np.nan, r"row 4, means\[1\]: found nan"),
    ("means", (4, 2), -np.inf, r"row 4, means\[2\]: found -inf"),
    ("means", (4, 0), 1e30, r"row 4, means\[0\]"),
    ("log_scales", (4, 2), 31, r"row 4, log_scales\[2\]: found 31.0, wanted between"),
    ("log_scales", (4, 2), -np.inf, r"row 4, log_scales\[2\]"),
    ("log_scales", (4, 0), np.nan, r"row 4, log_scales\[0\]"),
    ("logit_opacities", 4, np.nan, "row 4, logit_opacities: found nan"),
    ("quats", 4, 0, r"row 4, quats: found \[0.0, 0.0, 0.0, 0.0\], wanted a finite length"),
    ("quats", 4, 1e-30, "row 4, quats"),
    ("quats", (4, 3), 1e30, "row 4, quats"),
    ("quats", (4, 3), np.nan, "row 4, quats"),
    ("sh", (4, 3, 1), np.inf, r"row 4, sh\[3\]\[1\]"),
    ("sh", (4, 0, 0), 1e9, r"row 4, sh\[0\]\[0\]"),
]


@pytest.mark.parametrize(("column", "index", "value", "message"), BAD)
def test_one_bad_value_is_refused_with_its_place(column, index, value, message):
    scene = Scene.flat(spoiled(column, index, value))
    with pytest.raises(FormatError, match=rf"a\.ply: {message}.*1 of 9 rows .* repair"):
        checked(scene, "a.ply", repair=False)


REPAIRS = {
    "dropped_rows": [0, 1, 2, 5, 6, 10, 11, 12],
    "clamped_scales": [3, 4],
    "repaired_quaternions": [7, 8, 9],
}


@pytest.mark.parametrize(("rule", "case"), [(rule, case) for rule, cases in REPAIRS.items() for case in cases])
def test_repair_follows_the_documented_rule_and_counts_it(rule, case):
    column, index, value, _ = BAD[case]
    bad = spoiled(column, index, value)
    scene = checked(Scene.flat(bad), "a.ply", repair=True)
    assert json.loads(scene.source.metadata["repairs"]) == {rule: 1}
    others = np.delete(np.arange(9), 4)
    kept = others if rule != "dropped_rows" else np.arange(8)
    assert len(scene) == (8 if rule == "dropped_rows" else 9)
    for c in COLUMNS:
        assert same_bits(getattr(scene.gaussians, c)[kept], getattr(bad, c)[others])
    checked(scene, "again", repair=False)


def test_repaired_values():
    fixed = checked(Scene.flat(spoiled("log_scales", (4, 2), -np.inf)), "", repair=True).gaussians
    assert fixed.log_scales[4, 2] == -30
    fixed = checked(Scene.flat(spoiled("quats", 4, 0)), "", repair=True).gaussians
    np.testing.assert_array_equal(fixed.quats[4], [1, 0, 0, 0])
    fixed = checked(Scene.flat(spoiled("quats", 4, [3e-30, 0, 4e-30, 0])), "", repair=True).gaussians
    np.testing.assert_allclose(fixed.quats[4], [0.6, 0, 0.8, 0], rtol=1e-6)


@pytest.mark.parametrize("repair", [False, True, "drop"])
def test_infinite_logits_are_opacities_of_0_and_1(repair):
    g = random_gaussians(9, 1)
    g.logit_opacities[[2, 5, 7]] = np.inf, -np.inf, np.inf
    tree = GaussianTree(
        np.array([9, *range(2, 10)], np.int32), np.array([0] + 8 * [1], np.uint8), np.ones(9, np.float32)
    )
    for scene in (Scene.flat(g), Scene(g, tree)):  # no row is dropped, so levels stay
        read = checked(scene, "", repair=repair)
        logits = read.gaussians.logit_opacities
        np.testing.assert_array_equal(logits[[2, 5, 7]], LOGIT_FROM_BYTE[[255, 0, 255]])
        others = np.isfinite(g.logit_opacities)
        assert same_bits(logits[others], g.logit_opacities[others])
        assert all(same_bits(getattr(read.gaussians, c), getattr(g, c)) for c in COLUMNS if c != "logit_opacities")
        assert read.tree is scene.tree
        assert json.loads(read.source.metadata["repairs"]) == {"clamped_opacities": 3}
    assert LOGIT_FROM_BYTE[255] == np.float32(LOGIT_CERTAIN)


def test_an_infinite_logit_does_not_hide_what_else_is_wrong():
    g = spoiled("logit_opacities", 4, np.inf)
    g.logit_opacities[6] = np.nan
    with pytest.raises(FormatError, match=r"row 6, logit_opacities: found nan.*1 of 9 rows"):
        checked(Scene.flat(g), "a.ply", repair=False)
    for repair in (True, "drop"):
        scene = checked(Scene.flat(g), "a.ply", repair=repair)
        assert json.loads(scene.source.metadata["repairs"]) == {"clamped_opacities": 1, "dropped_rows": 1}
        assert len(scene) == 8 and scene.gaussians.logit_opacities[4] == np.float32(LOGIT_CERTAIN)


def test_writers_refuse_infinite_logits():
    with pytest.raises(FormatError, match="scene to write: row 4, logit_opacities: found inf"):
        refuse_unusable(spoiled("logit_opacities", 4, np.inf), "scene to write")


def test_values_at_the_limits_are_accepted():
    g = random_gaussians(4, 1)
    g.log_scales[0] = 30, -30, 30
    g.quats[1] = 1e-12, 0, 0, 2e-12
    g.quats[2] = 5e11, 5e11, 5e11, 0
    g.means[3] = 1e15
    g.logit_opacities[2] = -3e38
    scene = Scene.flat(g)
    assert checked(scene, "", repair=False) is scene


@pytest.mark.parametrize("n", [0, 1])
def test_empty_and_single_scenes_are_valid(n):
    scene = Scene.flat(random_gaussians(n, 0))
    assert checked(scene, "", repair=False) is scene


def test_a_scene_of_nothing_but_bad_rows_is_repaired_to_an_empty_one(tmp_path):
    g = random_gaussians(3, 0)
    bad = Gaussians(np.full_like(g.means, np.nan), g.quats, g.log_scales, g.logit_opacities, g.sh)
    splatree.write(Scene.flat(bad), tmp_path / "a.ply")
    assert len(splatree.read(tmp_path / "a.ply", repair=True)) == 0


def test_repairs_of_reading_and_of_values_are_added_up(tmp_path):
    splatree.write(Scene.flat(spoiled("means", 4, np.nan)), tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes((tmp_path / "a.ply").read_bytes()[:-10])
    scene = splatree.read([tmp_path / "a.ply", tmp_path / "a.ply"], repair=True)
    assert json.loads(scene.source.metadata["repairs"]) == {"missing_rows": 2, "dropped_rows": 2}


@pytest.mark.parametrize(("column", "index", "value", "message"), BAD)
def test_dropping_takes_the_whole_row_whatever_is_wrong(tmp_path, column, index, value, message):
    g = spoiled(column, index, value)
    splatree.write(Scene.flat(g), tmp_path / "a.ply")
    scene = splatree.read(tmp_path / "a.ply", repair="drop")
    rest = g.take(np.delete(np.arange(9), 4))
    assert all(same_bits(getattr(scene.gaussians, c), getattr(rest, c)) for c in COLUMNS)
    assert json.loads(scene.source.metadata["repairs"]) == {"dropped_rows": 1}


@pytest.mark.parametrize(
    ("column", "index", "limit"),
    [
        ("means", (4, 1), 1e15),
        ("means", (4, 1), -1e15),
        ("sh", (4, 2, 0), 1e6),
        ("sh", (4, 2, 0), -1e6),
        ("log_scales", (4, 0), 30.0),
        ("log_scales", (4, 0), -30.0),
    ],
)
def test_the_limits_stand_where_the_table_says(column, index, limit):
    """One step of float32 beyond a limit is refused; up to it a value is taken."""
    limit = np.float32(limit)
    if abs(float(limit)) > {"means": 1e15, "sh": 1e6, "log_scales": 30}[column]:
        limit = np.nextafter(limit, np.float32(0))  # the last value of float32 within
    beyond = np.nextafter(limit, np.float32(np.copysign(np.inf, limit)))
    within = Scene.flat(spoiled(column, index, limit))
    assert checked(within, "", repair=False) is within
    with pytest.raises(FormatError, match=f"row 4, {column}"):
        checked(Scene.flat(spoiled(column, index, beyond)), "", repair=False)


@pytest.mark.parametrize("length", [0.99e-12, 1.01e12])
def test_a_quaternion_a_hundredth_beyond_the_limits_is_refused_and_repaired(length):
    quat = np.float32(length) * np.float32([0.6, 0, 0.8, 0])
    scene = Scene.flat(spoiled("quats", 4, quat))
    with pytest.raises(FormatError, match="row 4, quats"):
        checked(scene, "", repair=False)
    fixed = checked(scene, "", repair=True)
    assert json.loads(fixed.source.metadata["repairs"]) == {"repaired_quaternions": 1}
    np.testing.assert_allclose(fixed.gaussians.quats[4], [0.6, 0, 0.8, 0], rtol=1e-6)
    inside = Scene.flat(spoiled("quats", 4, quat * np.float32(1.02 if length < 1 else 0.98)))
    assert checked(inside, "", repair=False) is inside


@pytest.mark.parametrize(
    ("found", "wanted"), [(35, 30), (80, 30), (np.inf, 30), (-35, -30), (-80, -30), (-np.inf, -30)]
)
def test_scales_beyond_the_limits_are_clamped_to_them(found, wanted):
    bad = spoiled("log_scales", (4, 1), found)
    fixed = checked(Scene.flat(bad), "", repair=True).gaussians
    assert fixed.log_scales[4, 1] == wanted
    bad.log_scales[4, 1] = wanted
    assert same_bits(fixed.log_scales, bad.log_scales)


def test_each_byte_of_opacity_has_the_logit_of_its_share():
    assert len(LOGIT_FROM_BYTE) == 256
    np.testing.assert_allclose(1 / (1 + np.exp(-LOGIT_FROM_BYTE.astype(np.float64))), np.arange(256) / 255, atol=1.1e-6)


def test_repairs_are_read_from_metadata_in_one_way():
    assert repairs_in({}) == {} and repairs_in_words({}) == ""
    repairs = repairs_in({"repairs": '{"clamped_scales": 1, "dropped_rows": 2000}'})
    assert repairs == {"clamped_scales": 1, "dropped_rows": 2000}
    assert repairs_in_words(repairs) == "clamped_scales 1, dropped_rows 2,000"
