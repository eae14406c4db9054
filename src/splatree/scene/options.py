"""How a view is selected and drawn: defaults live here alone; the command line's help is these docstrings."""

from dataclasses import dataclass
from typing import Final, Literal

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

PIXELS_MAX: Final = 1e30
"""Squares of so many pixels have room in float64, and they themselves in float32."""


def check_pixels(name: str, pixels: float) -> None:
    """Refuse what no size on the screen is compared with; infinity draws roots alone.

    Raises:
        InputError: it is below 0, NaN, or too large to be squared.
    """
    if not (0 <= pixels <= PIXELS_MAX or pixels == float("inf")):
        raise InputError(f"{name}: found {pixels}, wanted 0 px or more, at most {PIXELS_MAX:g} or inf")


@dataclass(frozen=True)
class SelectOptions:
    """Which nodes of a tree are drawn.

    Example:
        >>> few = st.render(scene, camera, select=st.SelectOptions(budget=100))
        >>> few.counters.num_selected <= 100
        True
    """

    pixel_error: float = PIXEL_ERROR
    """τ_R, px: a node stands for its subtree if its radius on the screen is at most this; 0 draws all leaves."""
    budget: int | None = None
    """Largest number of nodes to draw; pixel_error is raised until the nodes in view fit. None: no limit."""
    quality: float | None = None
    """PSNR against all leaves that a view shall have, dB, in place of a pixel error: 30 is rough, 40 hard to tell from all
    leaves. Measuring it takes one to four times as long as drawing all leaves. A budget goes before it. None: by pixel_error."""
    occlusion: bool = False
    """Draw with fewer nodes what nearer Gaussians hide: within a budget, near views come 1 to 10 dB nearer to all leaves, and far
    ones 1 dB. A picture of half the size is drawn first, on the processor. Not for stores."""
    rule: Rule = "cut"
    """Rule of the selection: `cut` is exact and draws nothing twice; the others reproduce published methods."""
    profile: Profile | None = None
    """Radius of a node, px: `exact` is 3 √λ of the dilated splat, `sphere` that of a ball of its extent, `pixel` its extent over
    the distance of its mean; None: as the levels were made for: `pixel` for levels by `build`, `sphere` for linked ones, else
    `exact`."""
    view_test: ViewTest = "footprint"
    """Nodes that are dropped as out of view: splats that miss the image (`footprint`), centres outside of it (`centre`), or
    none."""
    max_radius: float | None = None
    """Also drop nodes of a larger radius, px, leaves too (700 in the code of FilterGS); None: draw them."""
    cull: Cull | None = None
    """Rule by which clusters are left out before their rows are read; `exact` changes no bit of the picture. None: `exact` for
    scenes with clusters and no levels, `none` for trees, where the test of blocks leaves out as much."""

    def __post_init__(self) -> None:
        check_literals(self)
        check_pixels("pixel_error", self.pixel_error)
        if self.budget is not None and self.budget < 1:
            raise InputError(f"budget: found {self.budget}, wanted at least 1 node")
        if self.occlusion and self.rule != "cut":
            raise InputError(
                f"occlusion: found rule {self.rule!r}, wanted 'cut'; the others reproduce published methods"
            )
        if self.quality is not None:
            if not 0 < self.quality <= 200:
                raise InputError(f"quality: found {self.quality}, wanted a PSNR above 0 dB, at most 200")
            if self.pixel_error != PIXEL_ERROR:
                raise InputError(
                    f"quality: found {self.quality} beside pixel_error {self.pixel_error}, wanted one of them"
                )
            if self.rule != "cut":
                raise InputError(f"quality: found rule {self.rule!r}, wanted 'cut', whose pictures were measured")
        if self.max_radius is not None:
            check_pixels("max_radius", self.max_radius)
            if not self.max_radius > 0:
                raise InputError(f"max_radius: found {self.max_radius}, wanted more than 0 px")

    @property
    def resolved_profile(self) -> Profile:
        """The profile; `exact` if none was chosen and no scene was consulted."""
        return self.profile or "exact"


@dataclass(frozen=True)
class RenderOptions:
    """How the selected nodes become a picture.

    Example:
        >>> white = st.render(scene, camera, st.RenderOptions(background=(1, 1, 1)))
        >>> bool((white.image >= st.render(scene, camera).image).all())
        True
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Colour behind the scene, RGB 0 to 1."""
    mode: Mode | None = None
    """`classic` or `antialiased`; None: as the scene says."""
    dilation_px2: float = DILATION_PX2
    """Variance added to both axes of each splat, px²."""
    threshold: float | None = None
    """τ: opacity at which a splat ends; None: as the scene says (1/255 loses nothing)."""
    tile_rule: TileRule | None = None
    """Tiles that a splat is listed in: `ellipse` those in which its opacity reaches τ, `balanced` fewer for small splats at the
    same loss; `tau` and `3sigma` the squares of FilterGS's and 3DGS's code; None: as the scene says, else `ellipse`."""
    pixels: Pixels = "hard"
    """What a splat draws in its tiles: `hard` everything down to 1/255, so that edges of tiles show at a large τ; `taper` a
    smooth end before the first tile that it is not listed in."""
    sh_degree: int | None = None
    """Highest degree of harmonics that is evaluated; None: all that the scene has."""

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
