"""What Gaussians count when they are merged, and merging by named rules (kernels/reference/merge.py has the equations)."""

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.build import merge as kernel
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.thinning import Groups, Importance, MergeOptions, Weight
from splatree.shapes import Array, Float32

__all__ = ["check_finite", "importance_of", "largest_log_weight", "merge", "weights_of"]

WEIGHT_MIN = 1e-30
"""Smallest weight, relative to the scene's largest: a group of invisible Gaussians still has a mean."""


@checked
def merge(
    gaussians: Gaussians,
    groups: Groups,
    options: MergeOptions | None = None,
    *,
    mode: Mode = "classic",
    threads: int = 0,
) -> Gaussians:
    """Merge each group of Gaussians to one.

    Args:
        gaussians: the Gaussians.
        groups: which of them become one, for instance `Thinned.groups`.
        options: the rules; None: those that follow from the mode.
        mode: how the result will be drawn.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        One Gaussian for each group, in the order of the groups. A group of one is copied bit for bit.

    Raises:
        InputError: the opacity rule is `fitted`, which only merging by pairs can follow.

    Source:
        docs/explanation/thin.md; the equations are in kernels/reference/merge.py.

    Example:
        >>> flat = st.read("city.ply")
        >>> groups = st.thin(flat, st.ThinOptions(radius="auto")).groups
        >>> len(st.merge(flat.gaussians, groups)) == len(groups)
        True
    """
    options = (options or MergeOptions()).resolved(mode)
    return kernel.merge(gaussians, groups, weights_of(gaussians, options.weight or "opacity"), options, threads=threads)


def importance_of(gaussians: Gaussians, rule: Importance) -> Float32[Array, "n"]:
    """Logarithm of the importance: it orders alike and cannot overflow."""
    return _log_product(gaussians, rule)


def weights_of(gaussians: Gaussians, rule: Weight, *, log_unit: float | None = None) -> Float32[Array, "n"]:
    """Weights in units of e^``log_unit``; None: of the scene's largest (`largest_log_weight`)."""
    log_weights = _log_product(gaussians, rule)
    unit = log_weights.max(initial=-np.inf) if log_unit is None else np.float32(log_unit)
    weights: Array = np.exp(log_weights - unit)
    return np.maximum(weights, np.float32(WEIGHT_MIN))


def largest_log_weight(gaussians: Gaussians, rule: Weight) -> float:
    """Logarithm of the largest weight; 0 without Gaussians."""
    return float(_log_product(gaussians, rule).max()) if len(gaussians) else 0.0


def _log_product(gaussians: Gaussians, rule: Importance | Weight) -> Float32[Array, "n"]:
    # log α = −log(1 + e^−logit); np.logaddexp says the same ten times slower.
    logits = gaussians.logit_opacities
    log_alphas: Array = np.minimum(logits, 0) - np.log1p(np.exp(-np.abs(logits)))
    x, y, z = gaussians.log_scales.T  # column by column: reductions along an axis of three are ten times slower
    if rule == "opacity-scale":
        log_alphas += (x + y + z) * np.float32(1 / 3)
    elif rule == "opacity-area":
        log_alphas += x + y + z - np.minimum(np.minimum(x, y), z)
    return log_alphas


def check_finite(gaussians: Gaussians) -> None:
    """Refuse NaN and infinity, which would spread to every member of a group.

    Raises:
        InputError: names the first field and row.
    """
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        column = getattr(gaussians, name)
        # One pass without temporaries; a sum that overflows only costs the second look.
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.isfinite(column.sum(dtype=np.float32))
        if not finite:
            wrong = ~np.isfinite(column).reshape(len(column), -1).all(axis=1)
            if wrong.any():
                i = int(np.argmax(wrong))
                raise InputError(
                    f"{name}[{i}]: found {column[i].ravel()[:4]}, wanted finite numbers; {int(wrong.sum())} rows are not: "
                    f"read the file with repair, or drop them"
                )
    w, x, y, z = (column != 0 for column in gaussians.quats.T)
    is_rotation = w | x | y | z
    if not is_rotation.all():
        i = int(np.argmin(is_rotation))
        raise InputError(f"quats[{i}]: found zero, wanted a rotation; read the file with repair, or drop the row")
