"""Decide once, for the whole scene, what a build leaves open: the size of the first level, the unit of weights, the order.

A scene that is built in parts needs the same decisions in every part. They follow from a few measures of the whole scene
(`measure`), which a program that never has the whole scene in memory can put together from measures of its parts.
"""

import dataclasses
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from splatree.constants import MERGED_LOG_SCALE_MAX, SIGMAS
from splatree.errors import InputError
from splatree.lod.options import BuildOptions
from splatree.maths.morton import MortonFrame, morton_frame
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.scene.thinning import Importance, MergeOptions, Method
from splatree.simplify.merge import largest_log_weight
from splatree.simplify.thin import auto_radius
from splatree.simplify.visibility import pixel_size_of

__all__ = ["Measures", "ResolvedBuild", "first_pixel", "follows_pixels", "measure", "merge_rules", "resolve"]

FITTED_WIDENING = 0.34
"""`pairs`: what saturated nodes are widened by, where one thinning takes 0.3: far views of a city gain 0.2 dB."""

FIRST_SIZE = 1 / 12
"""`pairs`: s_0 in sizes of the median Gaussian."""

JUDGED_SIZE = 4.0
"""`pairs`: p_0 in sizes of the first level, a third of the median Gaussian. The levels finer than p_0 find what may be merged for
nothing: at generous budgets small objects gain 2 to 9 dB."""

STORED_SIZE = 24.0
"""`pairs`: the finest pixel that nodes are stored for, in p_0: eight median Gaussians. Far views draw fine levels there, as
generous budgets demand: a city at 20 to 40 % gains 1 to 2 dB."""

STORED_RADII = 4.0
"""`radius`: the finest pixel that nodes are stored for, in radii of the first level. At 8 means of scenes change by 0.03 dB."""

FINER_GROWTH = ((8.0, 2**0.5), (32.0, 2**0.25))
"""`pairs`: from so many p_0 on, a level is at most so many times as large as the one before. These levels hold few nodes, each of
many leaves: steps of 2 lost 0.2 to 0.7 dB on five scenes, and a frame of an object far away popped by 44.8 dB in place of 55."""

WIDEST_PIXEL = 16.0
"""`pairs` ends with pixels so many times as wide as the scene: no change of the picture can be as large as one of them."""


@dataclass(frozen=True)
class Measures:
    """What `resolve` has to know of a whole scene."""

    first_size: float
    """Radius or pixel size of the first level, world units: the one that was asked for, or the automatic one."""
    low: tuple[float, float, float]
    """Smallest coordinates of the means, world units."""
    high: tuple[float, float, float]
    """Largest coordinates of the means, world units."""
    largest_log_scale: float
    """Largest of all log-scales."""
    largest_log_weight: float
    """Logarithm of the largest weight of a Gaussian."""
    frame: MortonFrame
    """Grid of the Morton codes."""


@dataclass(frozen=True)
class ResolvedBuild:
    """How levels grow, with nothing left open: the same for every part of a scene."""

    method: Method
    """`radius` or `pairs`."""
    mode: Mode
    """The mode that the nodes are merged for."""
    first_size: float
    """Radius or pixel size of the first level, world units."""
    last_size: float
    """Growth ends with the first level that is larger than this, world units."""
    growth: float
    """Each level's size is so many times that of the one before; `pairs`: at most, coarse levels are closer together."""
    max_roots: int
    """Growth ends when at most this many nodes are left."""
    importance: Importance
    """`radius`: which of two close Gaussians a group forms around."""
    color_radius: float | None
    """`radius`: distance in linear RGB that counts as much as the radius in space; None: colour does not count."""
    visibility: bool
    """What others hide counts less. `radius`: merges are limited by what they change (lod/grow_radius.py)."""
    merge: MergeOptions
    """How a group becomes one Gaussian, with everything filled in."""
    log_unit: float
    """Logarithm of the weight that counts 1."""
    frame: MortonFrame
    """Grid of the Morton codes that rank the leaves."""

    def __post_init__(self) -> None:
        check_literals(self)

    @property
    def judged_size(self) -> float:
        """`pairs`: the size of levels that are judged at a pixel of this size, world units (lod/grow_pairs.py). `radius`: 0."""
        return JUDGED_SIZE * self.first_size if self.method == "pairs" else 0.0

    @property
    def stored_size(self) -> float:
        """The finest pixel that nodes are stored for, world units (lod/follow.py)."""
        return STORED_SIZE * self.judged_size if self.method == "pairs" else STORED_RADII * self.first_size

    def sizes(self) -> Iterator[float]:
        """The size of each level, from the finest on."""
        size = self.first_size
        yield size
        while 0 < size <= self.last_size:
            size *= self._growth_at(size)
            yield size

    def _growth_at(self, size: float) -> float:
        """Factor from a level of that size to the next."""
        if self.method == "radius":
            return self.growth
        finer = (growth for start, growth in FINER_GROWTH if size > 0.99 * start * self.judged_size)
        return min([self.growth, *finer])

    def sizes_from(self, first: int, count: int | None = None) -> Iterator[float]:
        """``count`` sizes after the ``first`` ones; None: all that there are."""
        return islice(self.sizes(), first, None if count is None else first + count)

    def to_json(self) -> str:
        """The decisions as a JSON object, for programs that build parts of one scene."""
        return json.dumps(dataclasses.asdict(self))

    @staticmethod
    def from_json(text: str) -> "ResolvedBuild":
        """What `to_json` wrote.

        Raises:
            InputError: the text holds something else.
        """
        try:
            fields: dict[str, Any] = json.loads(text)
            frame = MortonFrame(tuple(fields["frame"]["low"]), fields["frame"]["side"])
            return ResolvedBuild(**{**fields, "merge": MergeOptions(**fields["merge"]), "frame": frame})
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(f"resolved build: found {text[:80]!r}, wanted what to_json wrote ({error})") from error


def measure(leaves: Gaussians, options: BuildOptions, mode: Mode, *, threads: int = 0) -> Measures:
    """What `resolve` has to know of a scene, from all of its leaves.

    Args:
        leaves: the Gaussians of the whole scene.
        options: how levels are to grow; says which size is automatic.
        mode: how the scene is drawn.
        threads: threads to use; 0: all.

    Example:
        >>> import splatree as st
        >>> leaves = st.Gaussians.empty()
        >>> resolve(st.BuildOptions(radius=0.1), measure(leaves, st.BuildOptions(radius=0.1), "classic"), "classic").first_size
        0.1
    """
    if options.named_method == "pairs":
        first_size = options.pixel_size or first_pixel(pixel_size_of(leaves))
    else:
        first_size = auto_radius(leaves, threads=threads) if isinstance(options.radius, str) else float(options.radius)
    weight = merge_rules(options, mode).weight or "opacity"
    x, y, z = leaves.means.T if len(leaves) else np.zeros((3, 1))
    return Measures(
        first_size=first_size,
        low=(float(x.min()), float(y.min()), float(z.min())),
        high=(float(x.max()), float(y.max()), float(z.max())),
        largest_log_scale=float(leaves.log_scales.max(initial=-np.inf)),
        largest_log_weight=largest_log_weight(leaves, weight),
        frame=morton_frame(leaves.means),
    )


def resolve(options: BuildOptions, measures: Measures, mode: Mode) -> ResolvedBuild:
    """Fill in everything that the options leave to the scene.

    Args:
        options: how levels are to grow.
        measures: those of the whole scene.
        mode: how the scene is drawn.

    Returns:
        The decisions; give the same ones to every part of the scene.
    """
    sides = [high - low for low, high in zip(measures.low, measures.high, strict=True)]
    last_size = float(np.linalg.norm(sides))
    if options.named_method == "pairs":
        reach = SIGMAS * math.exp(min(measures.largest_log_scale, MERGED_LOG_SCALE_MAX))
        last_size = WIDEST_PIXEL * (last_size + reach)
    return ResolvedBuild(
        method=options.named_method,
        mode=mode,
        first_size=measures.first_size,
        last_size=last_size,
        growth=options.growth,
        max_roots=options.max_roots,
        importance=options.importance,
        color_radius=options.color_radius,
        visibility=options.visibility and (options.named_method == "pairs" or mode == "classic"),
        merge=merge_rules(options, mode),
        log_unit=measures.largest_log_weight,
        frame=measures.frame,
    )


def follows_pixels(options: BuildOptions, mode: Mode) -> bool:
    """Whether merged Gaussians follow the pixel that they are drawn at."""
    return options.follow and mode == "classic"


def first_pixel(median_size: float) -> float:
    """`pairs`: width of a pixel for which the first level is made, from the size of the median Gaussian; world units."""
    return max(FIRST_SIZE * median_size, float(np.finfo(np.float32).tiny))


def merge_rules(options: BuildOptions, mode: Mode) -> MergeOptions:
    """How a group becomes one Gaussian, with nothing left open."""
    merge = options.merge.resolved(mode, growth=options.growth, of_pairs=options.named_method == "pairs")
    if merge.opacity == "fitted" and merge.widening is None:
        return dataclasses.replace(merge, widening=FITTED_WIDENING)
    return merge
