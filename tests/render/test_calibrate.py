import json
import math
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.render.contribution import tile_contributions
from splatree.render.studio import THRESHOLD_MAX

from .test_pipeline import cloud

SCENE = st.Scene.flat(cloud(400, 1, degree=0))
SIZE = {"width": 64, "height": 48}
VIEWS = [replace(st.Camera.look_at((x, -0.5, -5), (0, 0, 0), **SIZE), name=f"v{x}") for x in (-1, 0, 2)]


def loss_of(threshold: float, tile_rule: str = "ellipse", scene_psnr: float = 30) -> float:
    """The mean loss as the module's head defines it, written out."""
    losses, depths = [], []
    for view in VIEWS:
        each = [st.RenderOptions(threshold=tau, tile_rule=tile_rule) for tau in (1 / 255, threshold)]  # type: ignore[arg-type]
        lossless, shrunk = (np.clip(st.render(SCENE, view, options).image, 0, 1) for options in each)
        ratio = np.mean((lossless.astype(float) - shrunk) ** 2) / 10 ** (-scene_psnr / 10)
        losses.append(10 * math.log10(1 + ratio))
        depths.append(depth_of(view))
    return larger_half(losses, depths)


def depth_of(view: st.Camera) -> float:
    """Mean depth of what a view sees; nan if that is nothing."""
    picture = st.render(SCENE, view)
    return float(np.average(picture.depth, weights=picture.alpha)) if picture.alpha.any() else math.nan


def larger_half(losses: list[float], depths: list[float]) -> float:
    """The larger mean of losses over the nearer and the farther half of the views that see something."""
    by_depth = [loss for depth, loss in sorted(zip(depths, losses, strict=True)) if not math.isnan(depth)]
    size = -(-len(by_depth) // 2)
    return max(float(np.mean(by_depth[:size])), float(np.mean(by_depth[-size:])))


def test_target_is_the_largest_threshold_within_the_budget() -> None:
    found = st.calibrate(SCENE, VIEWS, st.CalibrateOptions(loss_db=0.1))
    assert 1 / 255 < found.threshold < THRESHOLD_MAX
    assert found.tile_rule == "balanced"
    assert np.isclose(found.loss_db, loss_of(found.threshold, "balanced")) and found.loss_db <= 0.1
    assert loss_of(1.03 * found.threshold, "balanced") > 0.1  # found to 2 %
    assert found.num_pairs < found.num_pairs_lossless
    assert found.psnr is not None and 44 < found.psnr < 49  # 46.3 dB in each view would lose 0.1 dB


def test_worst_keeps_the_budget_in_each_view() -> None:
    """A crowded view close by, one from far away and one of nothing at all: the mean hides what the worst loses."""
    views = [*VIEWS, replace(st.Camera.look_at((0, 0, -40), (0, 0, 0), **SIZE), name="far")]
    views.append(replace(st.Camera.look_at((0, 0, -5), (0, 0, -9), **SIZE), name="away"))
    mean, worst = (st.calibrate(SCENE, views, st.CalibrateOptions(policy=policy)) for policy in ("target", "worst"))

    def losses(threshold: float) -> dict[str, float]:
        found = {}
        for view in views:
            ways = ((1 / 255, "ellipse"), (threshold, "balanced"))
            each = [st.RenderOptions(threshold=tau, tile_rule=rule) for tau, rule in ways]  # type: ignore[arg-type]
            lossless, shrunk = (np.clip(st.render(SCENE, view, options).image, 0, 1) for options in each)
            found[view.name] = 10 * math.log10(1 + 1e3 * np.mean((lossless.astype(float) - shrunk) ** 2))
        return found

    for found in (mean, worst):
        each = losses(found.threshold)
        assert found.worst_view == max(each, key=each.__getitem__)
        assert np.isclose(found.worst_loss_db, max(each.values()))
        assert np.isclose(found.loss_db, larger_half(list(each.values()), [depth_of(view) for view in views]))
    assert worst.worst_loss_db <= 0.1 < mean.worst_loss_db
    assert worst.exceeded == 1 / 6  # of six views alike, each is as likely the worst
    assert max(losses(1.03 * worst.threshold).values()) > 0.1  # found to 2 %
    assert worst.tile_rule == "balanced"
    assert worst.threshold < mean.threshold


def test_far_views_do_not_pay_for_near_ones() -> None:
    """Twelve views from so far that they lose little: a mean over all would let the three near ones lose five times as much."""
    far = [replace(st.Camera.look_at((0, 0, -60 - i), (0, 0, 0), **SIZE), name=f"far {i}") for i in range(12)]
    near = st.calibrate(SCENE, VIEWS, st.CalibrateOptions(loss_db=0.1))
    both = st.calibrate(SCENE, [*VIEWS, *far], st.CalibrateOptions(loss_db=0.1))

    def near_loss(threshold: float) -> float:
        return loss_of(threshold, "balanced")

    assert both.loss_db <= 0.1
    # Half of the views is nearer than the other: with them come some of the far ones, whose mean is that of 8 views.
    assert near_loss(both.threshold) <= near_loss(near.threshold) * 8 / len(VIEWS)


def test_balanced_draws_fewer_pairs_than_equal_thresholds_for_the_same_loss() -> None:
    balanced, equal = (
        st.calibrate(SCENE, VIEWS, render=st.RenderOptions(tile_rule=tile_rule))
        for tile_rule in ("balanced", "ellipse")
    )
    assert balanced.num_pairs < equal.num_pairs


def test_a_calibrated_scene_is_drawn_as_it_was_calibrated() -> None:
    found = st.calibrate(SCENE, VIEWS)
    drawn = [st.trace(st.calibrated(SCENE, found), view).bins.num_pairs for view in VIEWS]
    assert sum(drawn) == found.num_pairs


def test_a_larger_budget_gives_fewer_pairs() -> None:
    budgets = (0.02, 0.2, 1.0)
    found = [st.calibrate(SCENE, VIEWS, st.CalibrateOptions(loss_db=budget)) for budget in budgets]
    assert found[0].threshold < found[1].threshold < found[2].threshold
    assert found[0].num_pairs > found[1].num_pairs > found[2].num_pairs


def test_a_budget_that_nothing_exceeds_gives_the_largest_threshold() -> None:
    found = st.calibrate(SCENE, VIEWS, st.CalibrateOptions(loss_db=80))
    assert found.threshold == THRESHOLD_MAX and len(found.trials) == 2


def test_a_better_scene_is_shrunk_less() -> None:
    found = [st.calibrate(SCENE, VIEWS, st.CalibrateOptions(scene_psnr=psnr)).threshold for psnr in (25, 35)]
    assert found[0] > found[1]


@pytest.mark.parametrize("lists", ["ellipse", "3sigma"])
def test_formulas_of_paper_and_release(lists: str) -> None:
    options = st.RenderOptions(tile_rule=lists, threshold=1 / 255)  # type: ignore[arg-type]
    frames = [st.trace(SCENE, view, options) for view in VIEWS]
    g = np.mean([tile_contributions(frame).mean() for frame in frames])
    for lambda_g in (0.02, 0.1):
        for policy, threshold in (("paper", lambda_g / g), ("release", lambda_g * g)):
            asked = st.CalibrateOptions(policy=policy, lambda_g=lambda_g, lists=lists)  # type: ignore[arg-type]
            found = st.calibrate(SCENE, VIEWS, asked)
            assert np.isclose(found.contribution, g)
            assert np.isclose(found.threshold, np.clip(threshold, 1 / 255, THRESHOLD_MAX))
            assert np.isclose(found.loss_db, loss_of(found.threshold))


def test_no_policy_leaves_the_range() -> None:
    for lambda_g, wanted in ((1e-9, 1 / 255), (1e9, THRESHOLD_MAX)):
        for policy in ("paper", "release"):
            options = st.CalibrateOptions(policy=policy, lambda_g=lambda_g)  # type: ignore[arg-type]
            assert st.calibrate(SCENE, VIEWS, options).threshold == wanted


def test_fixed_is_the_threshold_of_the_options_and_its_loss_is_told() -> None:
    fixed = st.CalibrateOptions(policy="fixed")
    lossless = st.calibrate(SCENE, VIEWS, fixed)
    assert lossless.threshold == 1 / 255 and lossless.loss_db == 0 and lossless.psnr is None
    found = st.calibrate(SCENE, VIEWS, fixed, st.RenderOptions(threshold=0.1))
    assert found.threshold == 0.1 and np.isclose(found.loss_db, loss_of(0.1))


def test_photographs_replace_the_assumed_truth() -> None:
    rng = np.random.default_rng(0)
    pictures = {view.name: np.clip(st.render(SCENE, view).image, 0, 1) for view in VIEWS[:2]}
    photos = {name: np.clip(p + rng.normal(0, 0.1, p.shape), 0, 1).astype(np.float32) for name, p in pictures.items()}
    found = st.calibrate(SCENE, VIEWS, photos=photos)
    assert found.photographs and found.views == ("v-1", "v0")  # the third has no photograph
    losses = []
    for view in VIEWS[:2]:
        options = st.RenderOptions(threshold=found.threshold, tile_rule=found.tile_rule)
        shrunk = np.clip(st.render(SCENE, view, options).image, 0, 1)
        losses.append(st.psnr(pictures[view.name], photos[view.name]) - st.psnr(shrunk, photos[view.name]))
    assert np.isclose(found.loss_db, max(losses)) and found.loss_db <= 0.1  # of two views, each is a half
    # 20 dB of noise hide more than the 30 dB that are assumed without photographs.
    assert found.threshold > st.calibrate(SCENE, VIEWS[:2]).threshold


def test_views_are_taken_evenly_if_there_are_too_many() -> None:
    views = [replace(VIEWS[0], name=str(i)) for i in range(9)]
    assert st.calibrate(SCENE, views, st.CalibrateOptions(policy="fixed", max_views=3)).views == ("0", "4", "8")


def test_scene_keeps_threshold_and_provenance(tmp_path) -> None:
    found = st.calibrate(SCENE, VIEWS, st.CalibrateOptions(policy="fixed"), st.RenderOptions(threshold=0.07))
    path = tmp_path / "scene.splatree"
    st.write(st.calibrated(SCENE, found, held_out="every 8th"), path)
    scene = st.read(path)
    assert scene.threshold == 0.07 and scene.tile_rule == "ellipse"
    record = json.loads(scene.source.metadata["calibration"])
    assert record["policy"] == "fixed" and record["held_out"] == "every 8th" and record["views"] == ["v-1", "v0", "v2"]
    assert record["options"]["loss_db"] == 0.1 and record["pixels"] == "hard" and record["pixel_error"] == 3.0


def test_what_cannot_be_calibrated_is_refused() -> None:
    with pytest.raises(st.InputError, match="found no view"):
        st.calibrate(SCENE, [])
    with pytest.raises(st.InputError, match="found 3 views, none with a photograph"):
        st.calibrate(SCENE, VIEWS, photos={"other": np.zeros((48, 64, 3), np.float32)})
    with pytest.raises(st.InputError, match="found '3sigma', which does not depend on τ"):
        st.calibrate(SCENE, VIEWS, render=st.RenderOptions(tile_rule="3sigma"))
    for wrong in ({"loss_db": 0.0}, {"lambda_g": -1.0}, {"scene_psnr": math.inf}, {"max_views": 0}, {"policy": "best"}):
        with pytest.raises(st.InputError, match="found"):
            st.CalibrateOptions(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("psnr", [0.0, 201.0, 1e11])
def test_a_psnr_that_no_picture_has_is_refused(psnr):
    with pytest.raises(st.InputError, match="scene_psnr: found"):
        st.CalibrateOptions(scene_psnr=psnr)
