"""A scene: what one file holds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, NEAR
from splatree.errors import InputError, ShapeError
from splatree.scene.clusters import ClusterIndex
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.shapes import Array, UInt32, check_fields

NEAR_KEY = "near"
"""Where a scene says from which depth it is drawn, in ``source.metadata``."""

TileRule = Literal["ellipse", "balanced", "tau", "3sigma"]
"""Named rules for the tiles that a splat is listed in (docs/explanation/shrinking.md)."""


@dataclass(frozen=True)
class Source:
    """Where a scene came from."""

    paths: tuple[str, ...] = ()
    """Files or folders read, in order."""
    format: str = ""
    """Name of the format in the registry; empty if made in memory."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Rules and provenance: what made the levels, credits, the writer's name; JSON strings where structured. ``repairs`` counts
    what was fixed or dropped while reading; ``lost`` lists in sentences what of the file the scene does not hold, ``notes`` what
    the reader did."""
    origin: Origin = NO_ORIGIN
    """Where the zero of the scene lies in the world: world units to be added to the means (scene/origin.py)."""

    @property
    def near(self) -> float:
        """Depth from which the scene is drawn, world units: what its training took, or else the usual one.

        Raises:
            InputError: the metadata names no such depth.
        """
        text = self.metadata.get(NEAR_KEY, str(NEAR))
        try:
            near = float(text)
        except ValueError:
            near = math.nan
        if not 0 < near < math.inf:
            raise InputError(f"metadata near: found {text!r}, wanted a number of world units above 0")
        return near


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians, their tree of levels of detail, and how they must be drawn: what one file holds.

    Example:
        >>> scene = st.read("city.ply")
        >>> len(scene), scene.tree.num_levels, scene.mode
        (253, 1, 'classic')
    """

    gaussians: Gaussians
    """All nodes, leaves and merged ones, in the order of the tree."""
    tree: GaussianTree
    """Levels of detail; a forest of leaves if there are none."""
    ids: UInt32[Array, "n"] | None = None
    """Identity of each row, which permutations keep: splats at equal depth are blended in its order. None: the row number."""
    blocks: BlockIndex | None = None
    """Index of the tree for the selection; None: each selection makes it (`lod.blocks.with_blocks` keeps it)."""
    clusters: ClusterIndex | None = None
    """Clusters of rows, which culling leaves out whole (`build_clusters`); None: there are none."""
    mode: Mode = "classic"
    """How the scene was trained and must be drawn: `classic` or `antialiased`."""
    threshold: float = ALPHA_THRESHOLD
    """τ: opacity at which a splat ends."""
    tile_rule: TileRule | None = None
    """Tile rule that τ was chosen for; None: `ellipse`."""
    source: Source = Source()
    """Where the scene came from."""

    def __post_init__(self) -> None:
        check_literals(self)
        if len(self.tree) != len(self.gaussians):
            raise ShapeError(f"Scene.tree: found {len(self.tree)} rows, wanted {len(self.gaussians)}")
        check_fields(self, n=len(self.gaussians))
        if self.blocks is not None and not self.blocks.fits(self.gaussians.means, self.tree):
            raise ShapeError(
                "Scene.blocks: found the index of other Gaussians or another tree; replace it too, by None or with "
                "lod.blocks.with_blocks"
            )
        if self.clusters is not None and not self.clusters.fits(self.gaussians):
            raise ShapeError(
                "Scene.clusters: found the clusters of other Gaussians; replace them too, by None or with "
                "clusters.build.build_clusters"
            )
        if not 0 < self.threshold < 1:
            raise InputError(f"Scene.threshold: found {self.threshold}, wanted between 0 and 1")

    def __len__(self) -> int:
        return len(self.gaussians)

    @staticmethod
    def flat(gaussians: Gaussians, *, mode: Mode = "classic", source: Source | None = None) -> "Scene":
        """A scene without levels: each Gaussian is a root and a leaf."""
        n = len(gaussians)
        # Three standard deviations along the longest axis; a last bit is added so that rounding keeps it a bound. e^87 is the
        # last power that float32 holds.
        with np.errstate(invalid="ignore"):  # NaN gives NaN; whoever reads untrusted values checks them
            reach = np.maximum(gaussians.log_scales[:, 0], gaussians.log_scales[:, 1])
            np.maximum(reach, gaussians.log_scales[:, 2], out=reach)
            np.exp(np.minimum(reach, np.float32(87), out=reach), out=reach)
            reach *= np.float32(3 * (1 + 2**-20))
        tree = GaussianTree(
            subtree_end=np.arange(1, n + 1, dtype=np.int32),
            depth=np.zeros(n, np.uint8),
            extents=reach,
        )
        return Scene(gaussians, tree, mode=mode, source=source or Source())


def check_is_scene(scene: object, where: str) -> None:
    """Say how to come by a scene, where something else is given.

    Raises:
        InputError: ``scene`` is none.
    """
    if isinstance(scene, Gaussians):
        raise InputError(
            f"{where}: found Gaussians, wanted a Scene; make one with Scene.flat(gaussians, mode='classic')"
        )
    if not isinstance(scene, Scene):
        raise InputError(f"{where}: found {type(scene).__name__}, wanted a Scene; read one with splatree.read(path)")
