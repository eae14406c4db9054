import numpy as np
import pytest

import splatree as st
from splatree.kernels.reference.blend import blend
from splatree.render.contribution import contribution_histogram, tile_contributions

from .test_pipeline import ALL_LEAVES, CAMERA, cloud

KPC = st.Wanted(contributions=True)


def traced(backend: str = "cpu", **changes: object) -> st.Frame:
    """A cloud that leaves some tiles empty; contributions of each pair."""
    scene = st.Scene.flat(cloud(400, 1, degree=0))
    seen_by = st.Camera.look_at((0.3, -0.5, -9), (0, 0, 0), width=83, height=53)
    return st.trace(scene, seen_by, st.RenderOptions(**changes), ALL_LEAVES, device=backend, wanted=KPC)  # type: ignore[arg-type]


RULES = [{}, {"threshold": 0.1}, {"threshold": 0.1, "pixels": "taper"}, {"tile_rule": "tau", "threshold": 0.05}]


@pytest.mark.parametrize("changes", [*RULES, {"tile_rule": "3sigma"}])
def test_tiles_contribute_what_eq_5_says(changes: dict[str, object]) -> None:
    frame, literal = traced(**changes), traced("reference", **changes)
    found = tile_contributions(frame)
    wanted = np.add.reduceat(np.append(literal.contributions, 0), literal.bins.tile_start[:-1])
    wanted[np.diff(literal.bins.tile_start) == 0] = 0
    # Float32 products in the blend; a pair at τ adds 1/255 of a pixel, and a few may fall either way.
    np.testing.assert_allclose(found.sums_px, wanted, rtol=1e-4, atol=3 / 255)
    assert np.array_equal(found.num_pairs, np.diff(frame.bins.tile_start))
    assert found.num_pixels.sum() == 83 * 53 and found.num_pixels.max() == 256 and found.num_pixels[-1] == 3 * 5


@pytest.mark.parametrize("changes", [*RULES, {"tile_rule": "3sigma"}])
def test_pairs_contribute_what_eq_5_says(changes: dict[str, object]) -> None:
    frame = traced(**changes)
    literal = blend(frame.splats, frame.bins, frame.view)  # of the same lists
    np.testing.assert_allclose(frame.contributions, literal.contributions, rtol=1e-4, atol=2 / 255)
    assert np.isclose(frame.contributions.sum(dtype=np.float64), frame.result.alpha.sum(dtype=np.float64), rtol=1e-5)


def test_contributions_change_no_bit_of_the_picture() -> None:
    scene = st.Scene.flat(cloud(400, 1))
    plain, asked = (st.trace(scene, CAMERA, wanted=wanted) for wanted in (st.Wanted(), KPC))
    assert plain.contributions is None
    assert plain.result.image.tobytes() == asked.result.image.tobytes()
    assert plain.result.counters == asked.result.counters


def test_variants_by_hand() -> None:
    # A flat wide splat of opacity ½ over a picture of 20 × 16 px, and nothing else: 256 and 64 pixels of ½ in two tiles.
    g = st.Gaussians(
        np.array([[0, 0, 5]], np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
        np.full((1, 3), 8, np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 1, 3), np.float32),
    )
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=20, height=16)
    found = tile_contributions(st.trace(st.Scene.flat(g), seen_by))
    np.testing.assert_allclose(found.each(), [128, 32], rtol=1e-5)
    np.testing.assert_allclose(found.mean(), 80, rtol=1e-5)
    np.testing.assert_allclose(found.mean(unit="coverage"), 0.5, rtol=1e-5)


def test_empty_tiles_count_only_where_they_are_asked_for() -> None:
    found = tile_contributions(traced())
    empty = np.mean(found.num_pairs == 0)
    assert 0 < empty < 1
    assert np.isclose(found.mean(), (1 - empty) * found.mean(tiles="non-empty"))


def test_nothing_contributes_nothing() -> None:
    frame = st.trace(st.Scene.flat(st.Gaussians.empty()), CAMERA, wanted=KPC)
    assert tile_contributions(frame).mean() == tile_contributions(frame).mean(tiles="non-empty") == 0
    histogram = contribution_histogram([frame.contributions])
    assert histogram.num_pairs == 0 and histogram.used_ratio == 0


def test_every_pair_is_in_the_histogram_once() -> None:
    frames = [traced(tile_rule="3sigma"), traced(threshold=0.1)]
    histogram = contribution_histogram(frame.contributions for frame in frames)
    assert histogram.counts.sum() == histogram.num_pairs == sum(frame.bins.num_pairs for frame in frames)
    values = np.concatenate([frame.contributions for frame in frames])
    # Also those above 0.5 px, which the published count of used pairs leaves out.
    assert histogram.num_used == (values > 0).sum() > (values[values <= 0.5] > 0).sum()
    assert histogram.num_redundant == (values < 0.01).sum() == histogram.counts[0]
    assert 0 < histogram.used_ratio < 1


def test_what_cannot_be_counted_is_refused() -> None:
    with pytest.raises(st.InputError, match=r"Wanted\(contributions=True\)"):
        contribution_histogram([None])
    with pytest.raises(st.InputError, match="ascending"):
        contribution_histogram([], edges_px=(0, 1, 1))
    with pytest.raises(st.InputError, match="tiles: found 'some', wanted one of all, non-empty"):
        tile_contributions(traced()).mean(tiles="some")  # type: ignore[arg-type]
    with pytest.raises(st.InputError, match="unit: found 'px', wanted one of pixels, coverage"):
        tile_contributions(traced()).mean(unit="px")  # type: ignore[arg-type]
