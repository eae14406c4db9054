"""How the levels of a tree grow: defaults live here alone; the command line's help is these docstrings."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals
from splatree.scene.thinning import METHOD_FROM_OPTION, Importance, MergeOptions, Method, check_used

__all__ = ["BuildOptions"]

USERS: Final[Mapping[str, Method]] = {
    **{option: method for option, method in METHOD_FROM_OPTION.items() if option != "visibility"},
    "radius": "radius",
}
"""Options that one method alone uses."""


@dataclass(frozen=True)
class BuildOptions:
    """How levels of detail are built.

    Example:
        >>> tree = st.build_lod(st.read("city.ply"), st.BuildOptions(method="pairs", max_roots=8))
        >>> tree.tree.record.rule
        'pairs'
    """

    method: Method | Literal["auto"] = "auto"
    """`radius` merges Gaussians that are close, by ever larger radii. `pairs` merges what an ever wider pixel does not show, in
    twice the time. `auto` tries both on a sample of at most 60,000 Gaussians and takes what gives the better picture of as many
    nodes; an option that one method alone uses decides for this method."""
    radius: float | Literal["auto"] = "auto"
    """For `radius`: r_0, radius of the first level, world units. `auto`: 1.5 × the median distance to the nearest neighbour."""
    pixel_size: float | None = None
    """For `pairs`: s_0, width of a pixel for which the first level is made, world units; None: a twelfth of the median
    Gaussian."""
    visibility: bool = True
    """Gaussians that others hide count less: in what is merged, and in what merged nodes show if they follow. By `radius`, levels
    without it merge by distance alone. In mode `antialiased`, levels by a radius measure nothing: they always do so."""
    follow: bool = True
    """For scenes of mode `classic`: merged Gaussians follow the pixel that they are drawn at. Nearer than their level was made
    for, they become smaller and more transparent, as their leaves are there."""
    growth: float = 2.0
    """g: factor from the radius, or the pixel width, of one level to that of the next. Coarse levels by pairs are closer."""
    max_roots: int = 64
    """Construction ends when at most this many nodes are left."""
    importance: Importance = "opacity-scale"
    """For `radius`: which of two close Gaussians a group forms around: that of larger `opacity`, opacity times mean scale, or
    opacity times area."""
    color_radius: float | None = 0.5
    """For `radius`: ρ, the distance in linear RGB (DC colour) that counts as much as the radius in space; None: colour does not
    count."""
    merge: MergeOptions = field(default_factory=MergeOptions)
    """How a group becomes one Gaussian."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not isinstance(self.radius, str) and not 0 < self.radius <= 1e30:
            raise InputError(f"radius: found {self.radius}, wanted more than 0 world units, finite")
        if self.pixel_size is not None and not 0 < self.pixel_size <= 1e30:
            raise InputError(f"pixel_size: found {self.pixel_size}, wanted more than 0 world units, finite")
        if not 1 < self.growth <= 1e6:
            raise InputError(
                f"growth: found {self.growth}, wanted more than 1 (2 doubles the radius each level), at most 1e6"
            )
        if self.max_roots < 1:
            raise InputError(f"max_roots: found {self.max_roots}, wanted at least 1")
        if self.color_radius is not None and not self.color_radius > 0:
            raise InputError(
                f"color_radius: found {self.color_radius}, wanted more than 0, or none to leave colour out"
            )
        if (method := self.only_method) is not None:
            check_used(self, method, USERS)

    @property
    def only_method(self) -> Method | None:
        """The method that is named, or that alone uses what the options say; None: both suit."""
        if self.method != "auto":
            return self.method
        if self.merge.opacity == "fitted":
            return "pairs"
        usual = {field.name: field.default for field in dataclasses.fields(self)}
        return next((user for name, user in USERS.items() if getattr(self, name) != usual[name]), None)

    @property
    def named_method(self) -> Method:
        """The method, where nothing is tried.

        Raises:
            InputError: no method is named, and both suit.
        """
        if (method := self.only_method) is None:
            raise InputError(
                "method: found 'auto', wanted 'radius' or 'pairs': only build_lod tries them; try_methods says which is better"
            )
        return method
