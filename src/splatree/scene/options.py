"""How a view is selected and drawn: defaults live here alone; the command line's help is these docstrings."""

from dataclasses import dataclass
from typing import Literal

from splatree.constants import DILATION_MAX_PX2, DILATION_PX2, PIXEL_ERROR
from splatree.errors import InputError
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode, Profile
from splatree.scene.scene import TileRule

Rule = Literal["cut", "paper-strict", "release", "log-serial"]
"""Named rule sets of the selection (FilterGS §3.2 and its code; docs/explanation/select.md)."""

ViewTest = Literal["footprint", "centre", "none"]
"""Named tests that drop nodes of the cut which are out of view."""

Cull = Literal["none", "exact", "exact-inria", "exact-gsplat", "planes", "paper", "paper-guard", "paper-distance"]
"""Named rules that leave out clusters (clusters/cull.py; docs/explanation/clusters.md)."""

Pixels = Literal["taper", "hard"]
"""Named treatments of the pixels in these tiles where τ is above 1/255."""


@dataclass(frozen=True)
class SelectOptions:
    """Which nodes of the tree are drawn."""

    pixel_error: float = PIXEL_ERROR
    """τ_R, px: a node whose projected radius is at most this stands for its subtree; 0 draws all leaves."""
    budget: int | None = None
    """Draw at most this many nodes: pixel_error is raised until the visible cut fits."""
    rule: Rule = "cut"
    """Rule set: `cut` is exact and draws no duplicates; the others reproduce published code."""
    profile: Profile | None = None
    """Radius of a node, px: `exact` is 3 √λ of the dilated splat, `sphere` its extent over the distance; None: `sphere` for
    levels that were made for it, by pairs or linked, else `exact`."""
    view_test: ViewTest = "footprint"
    """Nodes dropped as out of view: splats that miss the image, centres outside of it, or nothing."""
    max_radius: float | None = None
    """Also drop nodes of a larger radius, px, leaves too (700 in the code of FilterGS); None: draw them."""
    cull: Cull | None = None
    """Clusters left out before their rows are read; `exact` changes no bit of the picture. None: `exact` for scenes with clusters
    and no levels; in a tree, none, as the test of blocks leaves out as much."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not self.pixel_error >= 0:
            raise InputError(f"pixel_error: found {self.pixel_error}, wanted 0 px or more")
        if self.budget is not None and self.budget < 1:
            raise InputError(f"budget: found {self.budget}, wanted at least 1 node")
        if self.max_radius is not None and not self.max_radius > 0:
            raise InputError(f"max_radius: found {self.max_radius}, wanted more than 0 px")

    @property
    def resolved_profile(self) -> Profile:
        """The profile; `exact` if none was chosen and no scene was consulted."""
        return self.profile or "exact"


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
    tile_rule: TileRule | None = None
    """Tiles of a splat: `ellipse` those that it reaches with opacity τ, `balanced` with less for large splats; `tau` and `3sigma`
    squares as the code of FilterGS and of 3DGS; None: as the scene says, else `ellipse`."""
    pixels: Pixels = "hard"
    """Pixels of these tiles: `hard` draws opacities down to 1/255, so that a large τ shows edges of tiles; `taper` lets each
    splat end smoothly before the first tile that it is not listed in."""
    sh_degree: int | None = None
    """Highest degree of harmonics evaluated; None: all that the scene has."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not all(0 <= channel <= 1 for channel in self.background):
            raise InputError(f"background: found {self.background}, wanted red, green and blue from 0 to 1")
        if not 0 <= self.dilation_px2 <= DILATION_MAX_PX2:
            raise InputError(f"dilation_px2: found {self.dilation_px2:g}, wanted 0 to {DILATION_MAX_PX2:g} px²")
        if self.threshold is not None and not 0 < self.threshold < 1:
            raise InputError(f"threshold: found {self.threshold}, wanted between 0 and 1")
        if self.pixels == "taper" and self.tile_rule in ("tau", "3sigma"):
            raise InputError(
                f"pixels: found 'taper' with tile_rule {self.tile_rule!r}, wanted 'hard', or tile_rule 'ellipse'"
            )
        if self.sh_degree is not None and not 0 <= self.sh_degree <= 3:
            raise InputError(f"sh_degree: found {self.sh_degree}, wanted 0 to 3")
