"""A view: a camera with everything that the stages of a frame ask about how it is drawn."""

from dataclasses import dataclass

from splatree.constants import ALPHA_THRESHOLD, DILATION_PX2, SHRINK_AREA_POWER
from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.given import given
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.scene.options import Pixels, RenderOptions
from splatree.scene.scene import Scene, TileRule

__all__ = ["View", "Wanted", "as_view", "view_of"]


@dataclass(frozen=True)
class Wanted:
    """Outputs of the blend beside colour and alpha. An output that is not wanted costs nothing.

    Example:
        >>> frame = st.trace(scene, camera, wanted=st.Wanted(median_depth=True))
        >>> frame.picture.median_depth.shape
        (36, 64)
    """

    contributions: bool = False
    """`Picture.contributions`: what each pair of splat and tile adds to the picture."""
    last_pair: bool = False
    """`Picture.last_pair`: the last pair that each pixel blended. Also makes the counts of `TileWork` exact."""
    median_depth: bool = False
    """`Picture.median_depth`: the depth at which half of the light is stopped."""

    depth: bool = True
    """`Picture.depth`: the blended depth, which is kept unless it is declined; `render` needs it."""

    @property
    def of_pixels(self) -> bool:
        """Whether anything beside colour, alpha and depth is wanted of each pixel."""
        return self.last_pair or self.median_depth


@dataclass(frozen=True, eq=False)
class View:
    """One view of one scene, with nothing left open. `view_of` makes it from a camera and `RenderOptions`.

    Example:
        >>> view = st.trace(scene, camera).view
        >>> view.mode, view.tile_rule, view.tapers
        ('classic', 'ellipse', False)
    """

    camera: Camera
    """Where the picture is taken from, and its size."""
    mode: Mode = "classic"
    """How the dilation changes the opacity."""
    dilation_px2: float = DILATION_PX2
    """Variance added to both axes of each splat, px²."""
    threshold: float = ALPHA_THRESHOLD
    """τ: the opacity at which a splat ends."""
    tile_rule: TileRule = "ellipse"
    """Rule for the tiles that a splat is listed in."""
    pixels: Pixels = "hard"
    """How splats end at the pixels of these tiles."""
    sh_degree: int = 3
    """Highest degree of harmonics that is evaluated, 0 to 3."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Colour behind the scene, RGB 0 to 1."""
    least_light: float = 0.0
    """A pixel is finished once less than this share of the light is left, and the splat that stopped it is drawn; then colour and
    alpha alone can be wanted. 0: a pixel is finished before a splat that would leave less than 10⁻⁴, which is not drawn."""
    wanted: Wanted = Wanted()
    """Outputs beside colour and alpha."""

    def __post_init__(self) -> None:
        check_literals(self)
        wanted = self.wanted
        if self.least_light and (wanted.depth or wanted.contributions or wanted.of_pixels):
            raise InputError(
                f"least_light: found {self.least_light:g} beside {wanted}, wanted no output beside colour and alpha: "
                "Wanted(depth=False)"
            )

    @property
    def is_square(self) -> bool:
        """Whether the tile rule lists squares instead of ellipses."""
        return self.tile_rule in ("tau", "3sigma")

    @property
    def area_power(self) -> float:
        """The power of its area with which a splat's τ falls."""
        return SHRINK_AREA_POWER if self.tile_rule == "balanced" else 0.0

    @property
    def least_threshold(self) -> float:
        """Smallest opacity at which any splat ends, for tests that do not know its area."""
        return min(self.threshold, ALPHA_THRESHOLD) if self.area_power else self.threshold

    @property
    def least_opacity(self) -> float:
        """Splats of a smaller opacity are not drawn; 0 for squares, which published code lists at any opacity."""
        return 0.0 if self.is_square else self.least_threshold

    @property
    def pixel_threshold(self) -> float:
        """Smallest opacity that is drawn at a pixel."""
        return min(self.threshold, ALPHA_THRESHOLD)

    @property
    def tapers(self) -> bool:
        """Whether splats are tapered; where τ is 1/255 or less there is nothing to taper."""
        return self.pixels == "taper" and self.threshold > ALPHA_THRESHOLD


def as_view(view: Camera | View) -> View:
    """A view; of a camera alone, the view with the usual options."""
    return View(view) if isinstance(view, Camera) else view


def view_of(scene: Scene, camera: Camera, options: RenderOptions | None = None, wanted: Wanted = Wanted()) -> View:
    """A view of a scene: what the options leave open is filled in from the scene."""
    options = given(options, RenderOptions, "options")
    return View(
        camera=camera,
        mode=options.mode if options.mode is not None else scene.mode,
        dilation_px2=options.dilation_px2,
        threshold=options.threshold if options.threshold is not None else scene.threshold,
        tile_rule=options.tile_rule or scene.tile_rule or "ellipse",
        pixels=options.pixels,
        sh_degree=options.sh_degree if options.sh_degree is not None else scene.gaussians.sh_degree,
        background=options.background,
        wanted=wanted,
    )
