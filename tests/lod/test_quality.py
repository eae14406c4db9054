"""Cuts that are chosen by the quality that is asked for (lod/quality.py, scene/quality.py)."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.edit.edit import edit
from splatree.edit.options import EditOptions
from splatree.errors import InputError
from splatree.lod.quality import COARSEST_PX, covered_share, curve_of, merged_share

from ..scenes import surface

CURVE = st.QualityCurve(40.0, -4.0, -1.0, -0.8, error_db=0.5, num_pictures=30)
CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)


def known(method: str = "radius", curve: st.QualityCurve | None = CURVE) -> st.Scene:
    scene = st.build_lod(st.Scene.flat(surface(600)), st.BuildOptions(method=method, max_roots=4))  # type: ignore[arg-type]
    return replace(scene, tree=replace(scene.tree, record=replace(scene.tree.record, quality=curve)))


def test_the_curve_is_its_formula():
    assert CURVE.psnr(math.e, merged=0.1, covered=1) == pytest.approx(40 - 4 + 10)
    assert CURVE.psnr(1, merged=1, covered=0.01) == pytest.approx(40 + 16)
    assert CURVE.psnr(3, merged=0, covered=1) == math.inf
    assert CURVE.psnr(0, merged=1, covered=1) == math.inf


@pytest.mark.parametrize(
    "change", [{"by_merged": 0.1}, {"by_pixel_error": 1.0}, {"offset": math.nan}, {"error_db": -1.0}]
)
def test_a_curve_that_rises_or_is_no_number_is_refused(change):
    with pytest.raises(InputError, match="QualityCurve"):
        replace(CURVE, **change)


def test_shares_are_sums_over_the_selected_nodes():
    """By the definition, node by node."""
    scene = known()
    rows = st.select(scene, CAMERA, st.SelectOptions(pixel_error=40)).rows
    g, pose, total, merged = scene.gaussians, CAMERA.camera_from_world, 0.0, 0.0
    tiles = np.zeros((10, 15))
    for row in rows:
        x, y, z = pose[:3, :3] @ g.means[row].astype(np.float64) + pose[:3, 3]
        square = np.prod(np.sort(g.scales()[row])[1:]) * (CAMERA.K[0, 0] / z) ** 2
        area = g.opacities()[row] * (square + 0.3)
        total, merged = total + area, merged + area * (not scene.tree.is_leaf[row])
        u, v = CAMERA.K[0, 0] * x / z + 120, CAMERA.K[1, 1] * y / z + 80
        if 0 <= u < 240 and 0 <= v < 160:
            tiles[int(v // 16), int(u // 16)] += g.opacities()[row] * min(2 * np.pi * square, 256)
    assert 0 < merged < total
    assert merged_share(scene, rows, CAMERA) == pytest.approx(merged / total, rel=1e-5)
    assert covered_share(scene, rows, CAMERA) == pytest.approx(np.mean(1 - np.exp(-1.5 * tiles / 256)), rel=1e-5)
    leaves = np.flatnonzero(scene.tree.is_leaf).astype(np.int32)
    assert merged_share(scene, leaves, CAMERA) == 0
    assert covered_share(scene, leaves[:0], CAMERA) == 0


@pytest.mark.parametrize("method", ["radius", "pairs"])
def test_the_cut_is_predicted_to_have_the_quality_and_a_coarser_one_is_not(method):
    scene = known(method)
    counts = []
    for quality in (28, 32, 36, 40):
        chosen = st.select(scene, CAMERA, st.SelectOptions(quality=quality))
        covered = covered_share(scene, st.select(scene, CAMERA, st.SelectOptions(pixel_error=12)).rows, CAMERA)

        def psnr_at(pixel_error, covered=covered):
            rows = st.select(scene, CAMERA, st.SelectOptions(pixel_error=pixel_error)).rows
            return CURVE.psnr(pixel_error, merged=merged_share(scene, rows, CAMERA), covered=covered)

        assert psnr_at(chosen.pixel_error) >= quality
        if chosen.pixel_error < COARSEST_PX:
            assert psnr_at(1.2 * chosen.pixel_error) < quality
        counts.append(len(chosen))
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_a_quality_that_no_cut_has_draws_all_leaves():
    scene = known("pairs", st.QualityCurve(20.0, 0.0, 0.0, 0.0, error_db=0.5, num_pictures=30))
    chosen = st.select(scene, CAMERA, st.SelectOptions(quality=30))
    assert scene.tree.is_leaf[chosen.rows].all()


def test_a_budget_goes_before_a_quality():
    scene = known()
    free = st.select(scene, CAMERA, st.SelectOptions(quality=40))
    assert len(free) > 60
    bound = st.select(scene, CAMERA, st.SelectOptions(quality=40, budget=60))
    assert len(bound) <= 60
    with st.open_session(scene, select=st.SelectOptions(quality=40)) as session:
        np.testing.assert_array_equal(
            session.draw(CAMERA).image, st.render(scene, CAMERA, select=lambda *_, **__: free).image
        )


def test_levels_of_unknown_quality_are_refused_with_advice():
    with pytest.raises(InputError, match=r"levels whose quality was not measured.*splatree build"):
        st.select(known(curve=None), CAMERA, st.SelectOptions(quality=40))


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"quality": 0}, "quality: found 0"),
        ({"quality": 40, "pixel_error": 2.0}, "beside pixel_error 2.0"),
        ({"quality": 40, "rule": "release"}, "found rule 'release'"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, found):
    with pytest.raises(InputError, match=found):
        st.SelectOptions(**options)


def test_the_curve_goes_through_files_edits_and_joins(tmp_path):
    scene = known()
    st.write(scene, tmp_path / "a.splatree")
    assert curve_of(st.read(tmp_path / "a.splatree")) == CURVE
    large = edit(scene, EditOptions(scale=8.0))
    assert curve_of(large) == CURVE  # all of it is measured in pixels and shares
    st.write(known(curve=None), tmp_path / "b.splatree")
    both = st.read([tmp_path / "a.splatree", tmp_path / "b.splatree"])
    assert both.tree.record.quality is None  # of one part nothing is known


def test_records_without_a_curve_are_read_and_strange_ones_refused():
    record = known().tree.record
    fields = json.loads(record.to_json())
    assert st.LevelRecord.from_json(json.dumps(fields)) == record
    del fields["quality"]
    assert st.LevelRecord.from_json(json.dumps(fields)).quality is None
    for strange in ({"offset": 1.0}, "high", {**vars(CURVE), "offset": "40"}):
        with pytest.raises(InputError, match=r"QualityCurve|level record"):
            st.LevelRecord.from_json(json.dumps({**fields, "quality": strange}))
