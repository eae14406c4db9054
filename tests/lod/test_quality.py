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
from splatree.lod.quality import COARSEST_PX, PRECISION_DB, curve_of, pixel_error_for
from splatree.lod.select import smallest_radius
from splatree.lod.sketch import Sketcher

from ..scenes import surface

CURVE = st.QualityCurve(25.0, -4.0, -1.0, 2.0, 0.2, -0.8, error_db=0.5, num_pictures=30)
POINT_PX = smallest_radius("exact")
CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)


def known(method: str = "radius", curve: st.QualityCurve | None = CURVE) -> st.Scene:
    scene = st.build_lod(st.Scene.flat(surface(600)), st.BuildOptions(method=method, max_roots=4))  # type: ignore[arg-type]
    return replace(scene, tree=replace(scene.tree, record=replace(scene.tree.record, quality=curve)))


def size_of(pixel_error: float, method: str = "radius") -> float:
    """Size of the largest merged nodes before the dilation; extents know of none."""
    return math.sqrt(pixel_error**2 - (POINT_PX**2 if method == "radius" else 0))


def test_the_curve_is_its_formula():
    assert CURVE.psnr(math.e, merged=0.1, varied=1) == pytest.approx(25 - 4 - 2)
    assert CURVE.psnr(1, merged=1, varied=0.01) == pytest.approx(25 + 16 + math.log(2))
    assert CURVE.psnr(3, merged=0, varied=0) == math.inf
    assert CURVE.psnr(0, merged=1, varied=1) == math.inf


@pytest.mark.parametrize(
    "change",
    [
        {"by_merged": 0.9},
        {"by_varied": 0.1},
        {"by_pixel_error": 1.0},
        {"by_fine": 0.1},
        {"fine_px": 0.0},
        {"offset": math.nan},
        {"error_db": -1.0},
    ],
)
def test_a_curve_that_rises_or_is_no_number_is_refused(change):
    with pytest.raises(InputError, match="QualityCurve"):
        replace(CURVE, **change)


@pytest.mark.parametrize("method", ["radius", "pairs"])
def test_the_cut_is_predicted_to_have_the_quality_and_a_coarser_one_is_not(method):
    scene = known(method)
    sketcher = Sketcher.of(scene)
    counts = []
    for quality in (28, 32, 36, 40):
        chosen = st.select(scene, CAMERA, st.SelectOptions(quality=quality))

        def psnr_at(pixel_error):
            rows = st.select(scene, CAMERA, st.SelectOptions(pixel_error=pixel_error)).rows
            return CURVE.psnr(pixel_error, **vars(sketcher.draw(rows, CAMERA)))

        assert psnr_at(chosen.pixel_error) >= quality
        if size_of(chosen.pixel_error, method) < 0.99 * COARSEST_PX:
            assert psnr_at(1.2 * chosen.pixel_error) < quality
        counts.append(len(chosen))
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_a_quality_that_no_cut_has_draws_all_leaves():
    scene = known("pairs", st.QualityCurve(20.0, 0.0, 0.0, 2.0, 0.0, 0.0, error_db=0.5, num_pictures=30))
    chosen = st.select(scene, CAMERA, st.SelectOptions(quality=30))
    assert scene.tree.is_leaf[chosen.rows].all()


def test_the_search_from_a_view_nearby_is_as_good_and_shorter():
    """Cuts of nodes whose quality falls evenly: what a search from 4 px finds in several cuts, the next one keeps in one."""
    scene = known()
    sketcher = Sketcher.of(scene)
    tried = []

    def rows_at(pixel_error):
        tried.append(pixel_error)
        chosen = st.select(scene, CAMERA, st.SelectOptions(pixel_error=pixel_error))
        return chosen.rows, chosen.num_visited

    alone = pixel_error_for(rows_at, sketcher, CAMERA, 36, point_px=POINT_PX)
    num_alone = len(tried)
    assert num_alone > 1
    assert pixel_error_for(rows_at, sketcher, CAMERA, 36, point_px=POINT_PX, last=alone) == pytest.approx(alone)
    assert len(tried) == num_alone + 1
    for last in (0.01, 3.0, 1e9, math.inf):
        found = pixel_error_for(rows_at, sketcher, CAMERA, 36, point_px=POINT_PX, last=last)
        spare = CURVE.psnr(found, **vars(sketcher.draw(rows_at(found)[0], CAMERA))) - 36
        coarser = 1.1 * found  # beyond what the search tells apart
        lack = CURVE.psnr(coarser, **vars(sketcher.draw(rows_at(coarser)[0], CAMERA))) - 36
        assert spare >= 0
        assert spare < PRECISION_DB or lack < 0


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
    older = {
        "offset": 30.0,
        "by_pixel_error": -4.0,
        "by_merged": -1.0,
        "by_covered": -0.8,
        "error_db": 1,
        "num_pictures": 9,
    }
    assert (
        st.LevelRecord.from_json(json.dumps({**fields, "quality": older})).quality is None
    )  # numbers of another meaning
    for strange in ({"offset": 1.0}, "high", {**vars(CURVE), "offset": "40"}):
        with pytest.raises(InputError, match=r"QualityCurve|level record"):
            st.LevelRecord.from_json(json.dumps({**fields, "quality": strange}))
