"""Pops: what switching levels changes, without the motion of the camera (render/popping.py)."""

from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError
from splatree.kernels.reference.select import shadowed

from ..scenes import surface

CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=80, height=56)


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return st.build_lod(st.Scene.flat(surface(400)), st.BuildOptions(max_roots=4))


def test_a_dolly_covers_a_share_of_what_is_left():
    """A wall five units away, drawn opaque: the median depth is its distance."""
    wall = surface(900)
    wall = replace(wall, means=wall.means * np.float32([1, 1, 0]), logit_opacities=np.full(len(wall), 8, np.float32))
    path = st.dolly(st.Scene.flat(wall), CAMERA, 4, step=0.1)
    left = np.array([-camera.position[2] for camera in path])
    np.testing.assert_allclose(left[1:] / left[:-1], 0.9, rtol=1e-2)  # depths are means over splats with a thickness
    assert [camera.name for camera in path] == [f"frame_{i:04d}" for i in range(4)]


def test_without_a_switch_nothing_pops(scene):
    pops = st.measure_pops(scene, st.dolly(scene, CAMERA, 3, step=0.05), st.SelectOptions(pixel_error=0))
    assert [(pop.psnr, pop.changed, pop.tile_change, pop.num_switched) for pop in pops] == [(np.inf, 0, 0, 0)] * 2
    assert {pop.num_nodes for pop in pops} == {scene.tree.num_leaves}


def test_a_pop_is_the_difference_of_two_cuts_from_one_camera(scene):
    """By the definition, with the whole cuts drawn as flat scenes."""
    path, select = st.dolly(scene, CAMERA, 2, step=0.3), st.SelectOptions(pixel_error=6)
    (pop,) = st.measure_pops(scene, path, select)
    cuts = [st.select(scene, camera, replace(select, view_test="none")).rows for camera in path]
    for rows in cuts:  # a cut stands for every leaf once
        chosen = np.zeros(len(scene), bool)
        chosen[rows] = True
        assert (chosen | shadowed(chosen, scene.tree.subtree_end))[scene.tree.is_leaf].all()
    assert (pop.num_nodes, pop.num_switched) == (len(cuts[1]), len(set(cuts[1]) - set(cuts[0])))
    assert pop.num_switched > 0

    def fixed(rows):
        return lambda view, threads=0: st.Selection(rows, "cut", "exact", 6.0)

    before, own = (np.clip(st.render(scene, path[1], select=fixed(rows)).image, 0, 1) for rows in cuts)
    change = np.abs(own.astype(np.float64) - before)
    assert pop.psnr == st.psnr(own, before)
    assert pop.pixel_change == change.max()
    assert pop.changed == (change.max(axis=2) > 4 / 255).mean()
    tiles = {(x, y): change[y : y + 16, x : x + 16].mean() for x in range(0, 80, 16) for y in range(0, 56, 16)}
    assert pop.tile_change == pytest.approx(max(tiles.values()))
    assert tiles[pop.tile_px] == pytest.approx(pop.tile_change)


def test_a_budget_is_met_by_what_is_in_view(scene):
    path = st.dolly(scene, CAMERA, 3, step=0.1)
    for camera, pop in zip(path[1:], st.measure_pops(scene, path, st.SelectOptions(budget=60)), strict=True):
        reached = st.select(scene, camera, st.SelectOptions(budget=60)).pixel_error
        cut = st.select(scene, camera, st.SelectOptions(pixel_error=reached, view_test="none"))
        assert pop.num_nodes == len(cut)


@pytest.mark.parametrize(
    ("frames", "step", "found"), [(1, 0.01, "frames: found 1"), (3, 0, "step: found 0"), (3, 1, "step: found 1")]
)
def test_a_path_that_does_not_move_is_refused(scene, frames, step, found):
    with pytest.raises(InputError, match=found):
        st.dolly(scene, CAMERA, frames, step=step)


def test_what_cannot_be_measured_is_refused(scene):
    away = st.Camera.look_at([0, 0, -6], [0, 0, -12], width=32, height=32)
    with pytest.raises(InputError, match="found nothing in view"):
        st.dolly(scene, away, 3)
    with pytest.raises(InputError, match="found 1, wanted at least two frames"):
        st.measure_pops(scene, [CAMERA])
    with pytest.raises(InputError, match="rule: found 'release'"):
        st.measure_pops(scene, [CAMERA, CAMERA], st.SelectOptions(rule="release"))


BOUNDS = {"radius": (52.5, 0.0026, 0.007), "pairs": (52.5, 0.0026, 0.007)}
"""PSNR, share of changed pixels and tile change that no pop passes; found were 53.9, 0.0023, 0.0056 and 52.8, 0.0024, 0.0061."""


@pytest.mark.parametrize("method", BOUNDS)
def test_pops_of_a_real_scene_stay_small(method):
    """A twentieth of the bundled city, three dollies at the default pixel error."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        city = st.read(path)
    leaves = st.Scene.flat(city.gaussians.take(np.arange(12_000, 24_000)))
    tree = st.build_lod(leaves, st.BuildOptions(method=method))
    pops = [
        pop
        for camera in st.flyout(leaves, st.PathOptions(views=4, width=240, height=160))[1:]
        for pop in st.measure_pops(tree, st.dolly(tree, camera, 5))
    ]
    assert sum(pop.num_switched for pop in pops) > 100
    psnr, changed, tile_change = BOUNDS[method]
    assert min(pop.psnr for pop in pops) >= psnr
    assert max(pop.changed for pop in pops) <= changed
    assert max(pop.tile_change for pop in pops) <= tile_change


def test_a_quality_is_that_of_the_first_frame(scene):
    path = st.dolly(scene, CAMERA, 3, step=0.1)
    kept = st.select(scene, path[0], st.SelectOptions(quality=34)).pixel_error
    assert kept > 0
    pops = st.measure_pops(scene, path, st.SelectOptions(quality=34))
    assert pops == st.measure_pops(scene, path, st.SelectOptions(pixel_error=kept))
