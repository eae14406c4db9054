import numpy as np
import pytest

from splatree.constants import MERGED_ALPHA_MAX
from splatree.io.opacities import areas_of_clamped, areas_of_powers, logits_from_opacities, opacities_from_logits


def area(footprint):
    """∫ α(u) du over u = r² / 2σ² from 0 on: the area it covers, in units of 2πσ²."""
    u = np.linspace(0, 60, 200_001)
    values = footprint(np.exp(-u))
    return float((values[:-1] + values[1:]).sum() * (u[1] - u[0]) / 2)


@pytest.mark.parametrize("a", [1.0, 1.01, 1.5, 3.0, 20.0, 4000.0])
def test_areas_are_the_integrals_of_the_footprints(a):
    # The integral by steps of 3e-4 is off by as much where the footprint has a corner.
    clamped, powered = areas_of_clamped(np.array([a]))[0], areas_of_powers(np.array([a]))[0]
    assert clamped == pytest.approx(area(lambda e: np.minimum(1, a * e)), abs=3e-4)
    assert powered == pytest.approx(area(lambda e: 1 - (1 - e) ** a), abs=3e-4)


def test_harmonic_numbers():
    np.testing.assert_allclose(areas_of_powers(np.array([1, 2, 3, 6])), [1, 1.5, 11 / 6, 2.45], atol=1e-6)
    assert areas_of_powers(np.array([0.3]))[0] == areas_of_powers(np.array([1.0]))[0]


def test_opacities_and_back():
    logits = np.linspace(-20, 12, 200, dtype=np.float32)
    back = logits_from_opacities(opacities_from_logits(logits), step_low=2.0**-148, step_high=2.0**-24)
    # Half a step of float32 below 1, 2^-25, is this much of a logit.
    alphas = 1 / (1 + np.exp(-logits.astype(np.float64)))
    assert (np.abs(back - logits) <= 2.0**-25 / (1 - alphas) + 2.0**-24 * np.abs(logits) + 2.0**-24).all()


def test_ends_are_half_a_step_away_and_above_one_is_opaque():
    found = logits_from_opacities(np.array([0, 1, 1.5, 700], np.float32), step_low=2.0**-8, step_high=2.0**-10)
    np.testing.assert_allclose(
        1 / (1 + np.exp(-found)), [2**-9, 1 - 2**-11, MERGED_ALPHA_MAX, MERGED_ALPHA_MAX], rtol=1e-6
    )
    assert np.isnan(logits_from_opacities(np.array([np.nan, -0.5]), step_low=1e-3, step_high=1e-3)).all()
