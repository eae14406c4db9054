"""Thinning by pairs: the two Gaussians whose merging changes the picture least become one, again and again.

Each round finds every Gaussian's cheapest partner among its nearest neighbours (kernels/reference/pairs.py has the cost),
takes the cheapest pairs that share no member, at most a quarter of the Gaussians, and merges them. Large and bright
differences count as much as they show, so this keeps what a view shows where `radius` keeps an even distance; near views
gain most. A count is met exactly.

Hidden Gaussians count less (visibility.py), in the cost and in the look of the merged one: a hidden Gaussian gives way to the one
before it.

A scene of mode `classic` is drawn with 0.3 px² added to each splat. The loss, and the opacity that a merged Gaussian needs,
therefore depend on the width of a pixel. The width is fixed once, for the distance at which the median Gaussian is a pixel
wide.

Cost: rounds are log₄⸝₃ of the factor; each takes about 2 µs a Gaussian for the neighbours and costs, and the merge.
"""

import dataclasses
import math

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.errors import InputError
from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build import pairs as kernel
from splatree.kernels.cpu.build.thin import group
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.thinning import Groups, ThinOptions
from splatree.shapes import Array, Float32
from splatree.simplify.merge import weights_of
from splatree.simplify.visibility import pixel_size_of, visibilities_in

__all__ = ["means_of_pairs", "merge_pairs"]

ROUND_SHARE = 0.25
"""Pairs that a round merges at most, as a share of the Gaussians: those cheapest to merge twice get their turn."""


def merge_pairs(
    gaussians: Gaussians, count: int, options: ThinOptions, *, mode: Mode, threads: int = 0
) -> tuple[Gaussians, Groups]:
    """``count`` Gaussians (at least 1), and the rows that each stands for; of the options, ``merge`` is resolved.

    Raises:
        InputError: those that are left are too far apart to find neighbours.
    """
    merge_options = options.merge
    fitted = merge_options.opacity == "fitted"
    dilation = 0.0
    if mode == "classic":
        dilation = DILATION_PX2 * (options.pixel_size or pixel_size_of(gaussians)) ** 2
    num_rows = num_left = len(gaussians)
    representatives = group_from_row = np.arange(num_rows, dtype=np.int32)
    rounds = 0
    with task("merge pairs", math.log(max(1.0, num_rows / count))) as advance:
        visibilities = np.ones(num_rows, np.float32)
        if options.visibility and count < num_rows:
            visibilities = visibilities_in(mode, gaussians, threads=threads)
        while num_left > count:
            weights = weights_of(gaussians, merge_options.weight or "opacity") * visibilities
            partner, costs, opacities = kernel.best_partners(
                gaussians, weights, visibilities, dilation=dilation, threads=threads
            )
            most = min(num_left - count, int(ROUND_SHARE * num_left) + 1)
            pairs = group(kernel.match_pairs(partner, costs, most, threads=threads))
            if len(pairs) == num_left:
                raise InputError(
                    f"count: found {num_left} Gaussians so far apart that float32 cannot hold their squared distances, "
                    f"wanted {count}; move or scale the scene"
                )
            gaussians = merge_kernel.merge(gaussians, pairs, weights, merge_options, threads=threads)
            visibilities = means_of_pairs(visibilities, pairs, weights)
            if fitted:
                is_pair = pairs.sizes == 2
                alphas = opacities[pairs.representatives[is_pair]].astype(np.float64)
                logits = gaussians.logit_opacities.copy()
                logits[is_pair] = np.log(alphas) - np.log1p(-alphas)
                gaussians = dataclasses.replace(gaussians, logit_opacities=logits)
            group_from_row = pairs.group_from_row[group_from_row]
            representatives = representatives[pairs.representatives]
            advance(math.log(num_left / len(gaussians)))
            num_left = len(gaussians)
            rounds += 1
    groups = group(representatives[group_from_row], rounds=rounds)
    return gaussians, groups


def means_of_pairs(values: Float32[Array, "n"], pairs: Groups, weights: Float32[Array, "n"]) -> Float32[Array, "g"]:
    """Weighted mean of the values of each pair; those of a group of one as they are."""
    first, last = pairs.rows[pairs.start[:-1]], pairs.rows[pairs.start[1:] - 1]
    share = weights[last] / (weights[first] + weights[last])
    return np.asarray(np.where(first == last, values[first], values[first] + share * (values[last] - values[first])))
