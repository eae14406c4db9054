"""The largest and smallest values that readers take: each format writes them, reads them back, and says what it clamped."""

import numpy as np
import pytest

import splatree as st
from splatree import InputError, WriteOptions

from ..scenes import random_gaussians

WRITTEN = [
    (".splatree", {}),
    (".splatree", {"compact": True}),
    (".ply", {}),
    (".compressed.ply", {}),
    (".splat", {}),
    *((".spz", {"format_version": version}) for version in (2, 3, 4)),
    (".glb", {}),
    (".glb", {"packing": "spz"}),
    (".sog", {}),
    *((".ksplat", {"compression": level}) for level in (0, 1, 2)),
    *((".hier", {"compression": level}) for level in (0, 1)),
    *((".rad", {"compression": level}) for level in (0, 1, 2)),
]
REFUSED = {".spz", ".glb spz", ".hier 1"}
"""Formats that cannot hold the largest coordinates or sizes, and say so."""


def extreme_scene():
    """Forty Gaussians, of which some are at the limits of io/check.py."""
    g = random_gaussians(40, degree=2)
    g.means[1], g.means[2] = (1e15, -1e15, 1e15), 1e-40
    g.log_scales[3], g.log_scales[4], g.log_scales[5] = 30, -30, (30, -30, 0)
    g.sh[6], g.sh[7], g.sh[8, 0], g.sh[9, 1:] = 1e6, -1e6, -1e6, 1e6
    g.logit_opacities[10], g.logit_opacities[11] = 3e38, -3e38
    g.quats[12], g.quats[13] = (1e12, 0, 0, 0), (0, 0, 0, -1.1e-12)
    return st.Scene.flat(g)


@pytest.mark.parametrize(("suffix", "options"), WRITTEN)
def test_what_is_written_at_the_limits_is_read_again(tmp_path, suffix, options):
    scene, path = extreme_scene(), tmp_path / f"a{suffix}"
    kind = {suffix, f"{suffix} {next(iter(options.values()), '')}"}
    if kind & REFUSED:
        with pytest.raises(InputError, match=r"found a (mean|coordinate or side) of"):
            st.write(scene, path, options=WriteOptions(**options))
        return
    lost = st.write(scene, path, options=WriteOptions(**options))
    again = st.read(path).gaussians
    # The rows of most formats are in another order, so the largest values are compared. Rounding is 2⁻¹¹ of half precision at
    # most, but for codes of eight bits (1/127).
    for name, beyond in (("log_scales", "log-scales|standard deviations"), ("sh", "colours|harmonics")):
        before, after = (np.abs(getattr(g, name)).max() for g in (scene.gaussians, again))
        is_told = any(word in line for word in beyond.split("|") for line in lost)
        assert is_told or after == pytest.approx(before, rel=1 / 127), (name, before, after, lost)


@pytest.mark.parametrize(
    ("suffix", "level", "told"),
    [
        (".ksplat", 1, ["standard deviations of 2 Gaussians", "harmonics of 3 Gaussians"]),
        (".ksplat", 2, ["standard deviations of 2 Gaussians", "harmonics of 3 Gaussians"]),
        (".rad", 1, ["beyond ±65504: clamped in 3 Gaussians"]),
        (".rad", 2, ["beyond ±65504: clamped in 1 Gaussian"]),
        (".hier", 1, ["beyond ±65504: clamped in 4 Gaussians"]),
    ],
)
def test_what_half_precision_clamps_is_counted(tmp_path, suffix, level, told):
    g = random_gaussians(20, degree=2)
    if suffix == ".ksplat":
        g.log_scales[3], g.log_scales[4] = 12, -18  # 2⁻²⁴ is e^−16.6
    g.sh[5:8, 3], g.sh[9, 0] = 7e4, 3e5  # ½ + C0 dc is beyond 65504 from 232,212 on
    if suffix == ".rad" and level == 1:
        g.sh[5] = 0
    lost = " ".join(st.write(st.Scene.flat(g), tmp_path / f"a{suffix}", options=WriteOptions(compression=level)))
    assert all(sentence in lost for sentence in told), lost


@pytest.mark.parametrize("suffix", [".ksplat", ".rad", ".hier"])
def test_wrong_options_name_the_file_that_was_asked_for(tmp_path, suffix):
    with pytest.raises(InputError, match=rf"^a{suffix}: found compression 7, wanted "):
        st.write(st.Scene.flat(random_gaussians(3)), tmp_path / f"a{suffix}", options=WriteOptions(compression=7))
