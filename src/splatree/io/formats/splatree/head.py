"""What a ``.splatree`` says of a whole scene beside its rows."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import InputError
from splatree.io.joined import joined_source
from splatree.scene.arguments import checked
from splatree.scene.levels import LevelRecord, common_record
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.scene.roots import Roots
from splatree.scene.scene import Scene, Source, TileRule

__all__ = ["SceneHead", "common_head"]


@dataclass(frozen=True)
class SceneHead:
    """A scene without its rows: how many there are, and how they are drawn.

    Example:
        >>> head = st.SceneHead.of(scene)
        >>> head.num_rows == len(scene)
        True
    """

    num_rows: int
    """Number of rows, leaves and merged nodes."""
    sh_degree: int
    """Degree of the spherical harmonics, 0 to 3."""
    mode: Mode = "classic"
    """How the scene must be drawn."""
    threshold: float = ALPHA_THRESHOLD
    """τ: opacity at which a splat ends."""
    tile_rule: TileRule | None = None
    """Tile rule that τ was chosen for; None: `ellipse`."""
    record: LevelRecord | None = None
    """How the levels were made and must be drawn; None: there are no levels, or nothing is known about them."""
    has_ids: bool = False
    """Whether each row has an identity."""
    has_curves: bool = False
    """Whether inner nodes follow the pixel that they are drawn at (`GaussianTree.curves`)."""
    roots: Roots | None = None
    """What merging must know to go on above the roots (`GaussianTree.roots`); None: it is not known."""
    source: Source = field(default_factory=Source)
    """Where the scene came from."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 0 <= self.num_rows < 2**31:
            raise InputError(f"SceneHead.num_rows: found {self.num_rows}, wanted 0 to 2^31 − 1")
        if self.sh_degree not in range(4):
            raise InputError(f"SceneHead.sh_degree: found {self.sh_degree}, wanted 0 to 3")
        if not 0 < self.threshold < 1:
            raise InputError(f"SceneHead.threshold: found {self.threshold}, wanted between 0 and 1")

    @staticmethod
    def of(scene: Scene) -> "SceneHead":
        """The head of a scene in memory."""
        return SceneHead(
            num_rows=len(scene),
            sh_degree=scene.gaussians.sh_degree,
            mode=scene.mode,
            threshold=scene.threshold,
            tile_rule=scene.tile_rule,
            record=scene.tree.record,
            has_ids=scene.ids is not None,
            has_curves=scene.tree.curves is not None,
            roots=scene.tree.roots,
            source=scene.source,
        )


@checked
def common_head(heads: Sequence[SceneHead]) -> SceneHead:
    """Make the head of scenes that will stand side by side in one file.

    Args:
        heads: heads of the scenes.

    Returns:
        A head with the sum of the rows and the joined records of levels.

    Raises:
        InputError: there are none, or they differ in how they are drawn.

    Example:
        >>> head = st.SceneHead.of(scene)
        >>> st.common_head([head, head]).num_rows == 2 * len(scene)
        True
    """
    if not heads:
        raise InputError("common_head: found no heads, wanted at least one")
    first = heads[0]
    for number, head in enumerate(heads):
        for name in ("mode", "threshold", "tile_rule"):
            if getattr(head, name) != getattr(first, name):
                raise InputError(
                    f"part {number}: found {name} {getattr(head, name)}, wanted {getattr(first, name)} as in part 0; wanted "
                    "scenes of one training"
                )
    return replace(
        first,
        num_rows=sum(head.num_rows for head in heads),
        sh_degree=max(head.sh_degree for head in heads),
        record=common_record([head.record for head in heads if head.record is not None]),
        has_ids=any(head.has_ids for head in heads),
        has_curves=any(head.has_curves for head in heads),
        roots=None,
        source=joined_source([head.source for head in heads]),
    )
