"""The search of a budget that begins at the τ_R of the view before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.errors import InputError
from splatree.lod.budget import NEXT_SHARE, meet_budget_from
from splatree.lod.select import count_nested, select
from splatree.render.build import build_lod
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

CAMERA = Camera.look_at([0, 0, -3], [0, 0, 0], width=64, height=48)


def surface(scale, num_roots=1):
    """The number of nodes of a surface, as τ_R decides it; counts the cuts that are asked for."""

    def rows_at(tau):
        rows_at.asked.append(tau)
        num = num_roots if np.isinf(tau) else max(num_roots, int(scale / max(tau, 0.01) ** 2))
        return np.zeros(min(num, 3_000_000), np.int8), num

    rows_at.asked = []
    return rows_at


@given(scale=st.floats(1e2, 3e5), budget=st.integers(1_000, 100_000), finest=st.floats(0, 3), last=st.floats(0.01, 1e5))
def test_any_start_meets_the_budget_and_nearly_fills_it(scale, budget, finest, last):
    rows, _, tau = meet_budget_from(surface(scale), budget, (finest, 0.0), last, CAMERA)
    assert len(rows) <= budget
    assert tau >= finest
    if tau > finest:
        assert len(rows) >= NEXT_SHARE * budget * 0.99


def test_a_start_that_fits_takes_one_cut_and_a_start_nearby_two():
    met = surface(1e6)
    _, _, tau = meet_budget_from(met, 10_000, (1.0, 0.0), 10.2, CAMERA)
    assert (met.asked, tau) == ([10.2], 10.2)
    for last in (9.5, 11.5):
        near = surface(1e6)
        meet_budget_from(near, 10_000, (1.0, 0.0), last, CAMERA)
        assert len(near.asked) == 2


def test_room_for_everything_ends_at_the_finest():
    rows, _, tau = meet_budget_from(surface(10), 2_000_000, (0.0, 1.6), 500.0, CAMERA)
    assert (len(rows), tau) == (100_000, 0.0)


def test_more_roots_than_the_budget_is_an_error():
    with pytest.raises(InputError, match="found 500 roots in view"):
        meet_budget_from(surface(1e4, num_roots=500), 100, (1.0, 0.0), 5.0, CAMERA)


def test_select_begins_at_the_last_view():
    rng = np.random.default_rng(3)
    n = 3000
    flat = Gaussians(
        rng.uniform(-1, 1, (n, 3)).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), -4, np.float32),
        np.zeros(n, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    scene = build_lod(Scene.flat(flat))
    options = SelectOptions(pixel_error=1.0, budget=400)
    alone = select(scene, CAMERA, options)
    for last in (alone.pixel_error, 0.5 * alone.pixel_error, 3 * alone.pixel_error, np.inf):
        moving = select(scene, CAMERA, options, last=last)
        assert 0.7 * 400 <= len(moving) <= 400  # steps of the tree are coarse in so small a scene
        assert count_nested(scene.tree, moving.rows) == 0
    unchanged = select(scene, CAMERA, options, last=alone.pixel_error)
    np.testing.assert_array_equal(unchanged.rows, alone.rows)
