"""How a view is selected and drawn: defaults live here alone; the command line's help is these docstrings."""

from dataclasses import dataclass
from typing import Literal, get_args

from splatree.constants import DILATION_PX2, PIXEL_ERROR
from splatree.errors import InputError
from splatree.scene.scene import Mode, Scene

Rule = Literal["cut", "paper-strict", "release", "log-serial"]
"""Named rule sets of the selection (FilterGS §3.2 and its code; docs/algorithms/select.md)."""

Profile = Literal["exact", "3dgs", "ref", "sphere"]
"""Named radius functions R(node, camera) in px."""

Visibility = Literal["footprint", "centre", "none"]
"""Named tests that drop nodes of the cut which cannot be seen."""


@dataclass(frozen=True)
class SelectOptions:
    """Which nodes of the tree are drawn."""

    pixel_error: float = PIXEL_ERROR
    """τ_R, px: a node whose projected radius is at most this stands for its subtree; 0 draws all leaves."""
    budget: int | None = None
    """Draw at most this many nodes: pixel_error is raised until the visible cut fits."""
    rule: Rule = "cut"
    """Rule set: `cut` is exact and draws no duplicates; the others reproduce published code."""
    profile: Profile = "exact"
    """Radius of a node, px: `exact` is 3 √λ of the dilated splat."""
    visibility: Visibility = "footprint"
    """What is dropped as out of view: splats that miss the image, centres outside of it, or nothing."""
    max_radius: float | None = None
    """Also drop nodes of a larger radius, px, leaves too (700 in the code of FilterGS); None: draw them."""

    def __post_init__(self) -> None:
        if not self.pixel_error >= 0:
            raise InputError(f"pixel_error: found {self.pixel_error}, wanted 0 px or more")
        if self.budget is not None and self.budget < 1:
            raise InputError(f"budget: found {self.budget}, wanted at least 1 node")
        if self.max_radius is not None and not self.max_radius > 0:
            raise InputError(f"max_radius: found {self.max_radius}, wanted more than 0 px")
        for name, kind in (("rule", Rule), ("profile", Profile), ("visibility", Visibility)):
            if getattr(self, name) not in get_args(kind):
                wanted = ", ".join(get_args(kind))
                raise InputError(f"{name}: found {getattr(self, name)!r}, wanted one of {wanted}")


@dataclass(frozen=True)
class RenderOptions:
    """How the selected nodes become a picture."""

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Colour behind everything, RGB 0 to 1."""
    mode: Mode | None = None
    """`classic` or `antialiased`; None: as the scene says."""
    dilation_px2: float = DILATION_PX2
    """Variance added to both axes of each splat, px²."""
    threshold: float | None = None
    """τ: opacity below which a splat ends; None: as the scene says (1/255 is lossless)."""
    sh_degree: int | None = None
    """Highest degree of harmonics evaluated; None: all that the scene has."""

    def __post_init__(self) -> None:
        if not self.dilation_px2 >= 0:
            raise InputError(f"dilation_px2: found {self.dilation_px2}, wanted 0 px² or more")
        if self.threshold is not None and not 0 < self.threshold < 1:
            raise InputError(f"threshold: found {self.threshold}, wanted between 0 and 1")
        if self.sh_degree is not None and not 0 <= self.sh_degree <= 3:
            raise InputError(f"sh_degree: found {self.sh_degree}, wanted 0 to 3")

    def resolved(self, scene: Scene) -> "ResolvedOptions":
        """The options with everything that is left to the scene filled in."""
        return ResolvedOptions(
            background=self.background,
            mode=self.mode if self.mode is not None else scene.mode,
            dilation_px2=self.dilation_px2,
            threshold=self.threshold if self.threshold is not None else scene.threshold,
            sh_degree=self.sh_degree if self.sh_degree is not None else scene.gaussians.sh_degree,
        )


@dataclass(frozen=True)
class ResolvedOptions:
    """`RenderOptions` for one scene, as the kernels take them: nothing left open."""

    background: tuple[float, float, float]
    """Colour behind everything, RGB 0 to 1."""
    mode: Mode
    """How dilation changes the opacity."""
    dilation_px2: float
    """Variance added to both axes of each splat, px²."""
    threshold: float
    """τ: opacity below which a splat ends."""
    sh_degree: int
    """Highest degree of harmonics evaluated."""
