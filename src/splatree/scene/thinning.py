"""How a scene is thinned and merged, and the groups that thinning finds.

Defaults live here alone; the command line's help is these docstrings. What a rule computes is said in
``kernels/reference/thin.py`` and ``merge.py``.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from splatree.constants import DILATION_PX2, PIXEL_ERROR, SIGMAS
from splatree.errors import InputError
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.shapes import Array, Float32, Int32, Int64, check_fields, in_short

Importance = Literal["opacity-scale", "opacity", "opacity-area"]
"""Which Gaussian stays when two are close: opacity times the geometric mean of the scales, opacity alone, or opacity times
the product of the two largest scales."""

Weight = Literal["opacity", "opacity-scale", "opacity-area"]
"""How much a member counts in a mean; the same three products."""

MergeRule = Literal["moments", "mean"]
"""`moments` keeps mass, mean and covariance of the group; `mean` averages axis by axis (the literal radius scheme)."""

OpacityRule = Literal["standard", "optical", "union", "mass", "fitted"]
"""Opacity of a merged Gaussian; kernels/reference/merge.py has the equations, of `fitted` kernels/reference/pairs.py."""

Position = Literal["centroid", "representative"]
"""Where a merged Gaussian stands."""


@dataclass(frozen=True)
class MergeOptions:
    """How the Gaussians of a group become one.

    Example:
        >>> optical = st.ThinOptions(keep=0.5, merge=st.MergeOptions(opacity="optical"))
        >>> len(st.thin(st.read("city.ply"), optical))
        126
    """

    rule: MergeRule = "moments"
    """Shape: `moments` keeps mean and covariance of the group; `mean` averages scales and quaternions axis by axis."""
    weight: Weight | None = None
    """Weight of a member in means: `opacity`, opacity times mean scale, or opacity times area; None: `opacity-area` in a scene of
    mode `antialiased`, whose splats keep their mass however small they get, else `opacity`."""
    opacity: OpacityRule | None = None
    """Opacity of the merged Gaussian: `union` 1 − Π(1 − α); `mass` Σ α A / A; `standard` the larger of both, where a mass above 1
    widens the Gaussian; `optical` keeps the optical depth of the group; `fitted`, for pairs alone, the opacity that changes
    the picture least. None: `optical` in a scene of mode `antialiased`, else `fitted` for pairs and `standard` for larger
    groups."""
    position: Position = "centroid"
    """Place of the merged Gaussian: the `centroid`, or that of the `representative`, which keeps the smallest distance."""
    scale_bound: float | None = None
    """κ: no axis is longer than κ times the weighted mean of the members; None: 1.5 for `mean`, no bound for `moments`."""
    widening: float | None = None
    """For `standard` and `fitted`: a mass m > 1 over the merged area multiplies the scales by m to this power; None: 0.3 for
    `fitted`, else 0.4."""
    mass_limit: float = 5.0
    """For `standard` and `fitted`: mass above this is not drawn."""
    dilation: float | None = None
    """Added to variances where areas are compared, in units of the merged σ_max², and for levels by pairs in units of the squared
    width of their pixel. None: what the renderer's dilation amounts to where a node is drawn, for the levels of a scene of
    mode `classic`; else 0."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.scale_bound is not None and not self.scale_bound > 0:
            raise InputError(f"scale_bound: found {self.scale_bound}, wanted more than 0, or none")
        if not self.mass_limit >= 1:
            raise InputError(f"mass_limit: found {self.mass_limit}, wanted 1 or more")
        if not all(value is None or value >= 0 for value in (self.widening, self.dilation)):
            raise InputError(f"widening, dilation: found {self.widening}, {self.dilation}, wanted 0 or more")

    def resolved(self, mode: Mode, *, growth: float | None = None, of_pairs: bool = False) -> "MergeOptions":
        """The options with what follows from the mode of the scene, for levels that grow by ``growth`` or for one thinning.

        ``of_pairs``: groups are pairs whose cost is known, which gives the `fitted` opacity.

        `antialiased` splats keep their mass at any distance, so true areas weigh and compare. `classic` ones are dilated by
        0.3 px². A node is drawn from where σ² + 0.3 = 1 px² (3 σ is τ_R = 3 px) to g times as far, where its parent takes
        over; in the middle, at p² = g σ² / 0.7, the dilation is 0.3 p², which makes all small members count alike. Levels by
        pairs know their p. A scene that is thinned once has no such distance.

        Raises:
            InputError: `fitted` opacity of larger groups.
        """
        if self.opacity == "fitted" and not of_pairs:
            others = ", ".join(rule for rule in get_args(OpacityRule) if rule != "fitted")
            raise InputError(f"opacity: found 'fitted', wanted one of {others}: only merging by pairs fits it")
        classic = mode == "classic"
        dilation = 0.0
        if classic and growth is not None:
            drawn_px2 = (PIXEL_ERROR / SIGMAS) ** 2
            dilation = DILATION_PX2 if of_pairs else DILATION_PX2 * growth / (drawn_px2 - DILATION_PX2)
        return dataclasses.replace(
            self,
            weight=self.weight or ("opacity" if classic else "opacity-area"),
            opacity=self.opacity or ("optical" if not classic else "fitted" if of_pairs else "standard"),
            dilation=dilation if self.dilation is None else self.dilation,
        )

    @property
    def power(self) -> float:
        """`widening` as a number."""
        if self.widening is not None:
            return self.widening
        return 0.3 if self.opacity == "fitted" else 0.4

    @property
    def bound(self) -> float:
        """κ as a number; infinity where there is none."""
        if self.scale_bound is not None:
            return self.scale_bound
        return 1.5 if self.rule == "mean" else float("inf")


Method = Literal["pairs", "radius"]
"""How Gaussians are chosen for merging: `pairs` merges the two whose merging changes the picture least, again and again
(simplify/pairs.py); `radius` keeps an even distance: all within r of a more important one join it."""

METHOD_FROM_OPTION: Mapping[str, Method] = {
    "importance": "radius",
    "color_radius": "radius",
    "pixel_size": "pairs",
    "visibility": "pairs",
}
"""Options that one method alone uses."""


def check_used(options: Any, method: Method, method_from_option: Mapping[str, Method]) -> None:
    """Refuse options that are not what they are by default although the method does not use them."""
    for option in dataclasses.fields(options):
        user, value = method_from_option.get(option.name, method), getattr(options, option.name)
        if user != method and value != option.default:
            raise InputError(
                f"{option.name}: found {value!r}, but the method {method!r} does not use it, wanted {option.default!r}; "
                f"leave it out, or choose the method {user!r}"
            )


@dataclass(frozen=True)
class ThinOptions:
    """How far a scene is thinned. Give one of radius, keep and count; without any of them the radius is `auto`.

    Example:
        >>> len(st.thin(st.read("city.ply"), st.ThinOptions(count=60)))
        60
    """

    method: Method | None = None
    """`pairs` changes the picture least; `radius` keeps an even distance; None: `pairs` for a share or a count, else `radius`."""

    radius: float | Literal["auto"] | None = None
    """Smallest distance between representatives, world units. `auto`: 1.5 × the median distance to the nearest neighbour."""
    keep: float | None = None
    """Share of the Gaussians to keep, 0 to 1. The method `radius` finds the radius by bisection, to 1 % of the count."""
    count: int | None = None
    """Number of Gaussians to keep. The method `radius` meets it to 1 %."""
    importance: Importance = "opacity-scale"
    """For `radius`: which of two close Gaussians stays: that of larger `opacity`, opacity times mean scale, or opacity times
    area."""
    color_radius: float | None = 0.5
    """For `radius`: ρ, the distance in linear RGB (DC colour) that counts as much as the radius in space; None: colour does not
    count."""
    pixel_size: float | None = None
    """For `pairs` in mode `classic`: width of a pixel, world units, where the scene is seen; None: as large as its median
    Gaussian."""
    visibility: bool = True
    """For `pairs`: Gaussians that others hide from all around count less."""
    merge: MergeOptions = field(default_factory=MergeOptions)
    """How a group becomes one Gaussian."""

    def __post_init__(self) -> None:
        check_literals(self)
        given = [name for name in ("radius", "keep", "count") if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError(f"thin: found {' and '.join(given)}, wanted one of radius, keep and count")
        if self.method == "pairs" and (self.keep, self.count) == (None, None):
            raise InputError("method: found 'pairs' without a count, wanted keep or count; a radius goes with 'radius'")
        if self.pixel_size is not None and not 0 < self.pixel_size <= 1e30:
            raise InputError(f"pixel_size: found {self.pixel_size}, wanted more than 0 world units, finite")
        if not isinstance(self.radius, str | None) and not 0 <= self.radius <= 1e30:
            raise InputError(f"radius: found {self.radius}, wanted 0 or more world units, finite")
        if self.keep is not None and not 0 < self.keep <= 1:
            raise InputError(f"keep: found {self.keep}, wanted more than 0 and at most 1 (0.25 keeps a quarter)")
        if self.count is not None and self.count < 1:
            raise InputError(f"count: found {self.count}, wanted at least 1")
        if self.color_radius is not None and not self.color_radius > 0:
            raise InputError(
                f"color_radius: found {self.color_radius}, wanted more than 0, or none to leave colour out"
            )
        check_used(self, self.chosen_method, METHOD_FROM_OPTION)

    @property
    def chosen_method(self) -> Method:
        """`method`, or what follows where it is None."""
        return self.method or ("radius" if (self.keep, self.count) == (None, None) else "pairs")


@dataclass(frozen=True, eq=False)
class Groups:
    """A partition of ``n`` rows into ``g`` groups, each around a representative.

    Example:
        >>> groups = st.thin(st.read("city.ply"), st.ThinOptions(keep=0.5)).groups
        >>> int(groups.sizes.sum())
        253
    """

    representatives: Int32[Array, "g"]
    """Row around which each group was formed, ascending."""
    group_from_row: Int32[Array, "n"]
    """Group of each row."""
    start: Int64[Array, "g+1"]
    """Members of group ``i`` are ``rows[start[i] : start[i + 1]]``."""
    rows: Int32[Array, "n"]
    """Rows by group, ascending inside each group."""
    rounds: int = 0
    """Number of rounds of parallel decisions; 0 if the decisions were sequential."""
    num_visited: int = 0
    """Number of pairs of row and candidate that were looked at."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.representatives)

    @property
    def sizes(self) -> Int64[Array, "g"]:
        """Number of members of each group."""
        return np.diff(self.start)


@dataclass(frozen=True, eq=False)
class MergeLimit:
    """How much it may change the picture that a Gaussian joins another: E of kernels/reference/pairs.py, not dilated."""

    gaussians: Gaussians
    """The Gaussians."""
    weights: Float32[Array, "n"]
    """How much each counts in a merged one."""
    visibilities: Float32[Array, "n"]
    """How much of each is seen, 0 to 1."""
    most: float
    """The largest E of a merge, world units²."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_fields(self)


def rules_of(options: MergeOptions | ThinOptions) -> dict[str, object]:
    """The options as plain values, for the metadata of what they made."""
    return dataclasses.asdict(options)
