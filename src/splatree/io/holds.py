"""What a format can hold of a scene, and so what is lost when a scene is written in it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from splatree.constants import ALPHA_THRESHOLD, SH_MAX_DEGREE
from splatree.io.notes import origin_in_words
from splatree.scene.levels import UNKNOWN_LEVELS, LevelRecord
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin

Levels = Literal["none", "one of", "tree"]
"""Levels of detail: the file has none; `read` takes one of several; the file keeps the tree."""


@dataclass(frozen=True)
class Holds:
    """What a file of a format can say."""

    lossless: bool = False
    """Whether columns that are written read back bit for bit."""
    levels: Levels = "none"
    """Levels of detail."""
    sh_degree: int = SH_MAX_DEGREE
    """Largest degree of harmonics."""
    modes: tuple[Mode, ...] = ("classic", "antialiased")
    """Modes that it can name; other scenes are read back as the first of them."""
    threshold: bool = False
    """Whether it names τ, the opacity below which a splat ends."""
    record: bool = False
    """Whether it keeps how levels were made and are to be drawn (`LevelRecord`, and the extents that belong to it)."""
    curves: bool = False
    """Whether it keeps how merged nodes follow the pixel that they are drawn at (`GaussianTree.curves`)."""
    clusters: bool = False
    """Whether it keeps clusters."""
    origin: bool = False
    """Whether it keeps where the zero of the scene lies in the world, or writes coordinates precisely enough to need none."""
    axes: str = "as in the scene"
    """Axes that the format prescribes; the scene is turned to them and back."""


def origin_lost(holds: Holds, name: str, origin: Origin) -> Iterator[str]:
    """That coordinates are relative to an origin which the format ``name`` cannot hold."""
    if origin != NO_ORIGIN and not holds.origin:
        yield f"the origin {origin_in_words(origin)}: {name} cannot hold it, its coordinates are relative to it"


def losses(
    holds: Holds,
    name: str,
    *,
    sh_degree: int,
    mode: Mode,
    threshold: float = ALPHA_THRESHOLD,
    num_merged: int = 0,
    num_clusters: int = 0,
    record: LevelRecord | None = None,
    has_curves: bool = False,
) -> Iterator[str]:
    """What of a scene the format ``name`` cannot hold, a sentence each; what follows from the values says its writer.

    ``num_merged`` counts the nodes of a tree that are left out because its leaves are written, ``num_clusters`` the clusters that
    are not written. ``record`` says how the levels were made that are written, ``has_curves`` whether their nodes follow the
    pixel that they are drawn at.
    """
    if num_merged:
        yield f"the levels of detail, {num_merged:,} merged nodes: {name} gets the leaves"
    if num_clusters:
        yield f"the {num_clusters:,} clusters: the file gets none"
    if record is not None and record != UNKNOWN_LEVELS and not holds.record:
        yield (
            f"how levels are drawn: they were made by the rule {record.rule} for the profile {record.profile}; {name} cannot say "
            "it, and what reads the file has to choose"
        )
    if has_curves and not holds.curves:
        yield (
            f"how merged nodes look nearer than their level was made for: {name} holds them as they are at their level; "
            "`splatree stream` writes them as viewers with a budget draw them"
        )
    if sh_degree > holds.sh_degree:
        above = (
            f"degree {sh_degree}"
            if sh_degree == holds.sh_degree + 1
            else f"degrees {holds.sh_degree + 1} to {sh_degree}"
        )
        yield f"the harmonics of {above}: {name} holds no more than degree {holds.sh_degree}"
    if mode not in holds.modes:
        yield f"the mode {mode}: {name} cannot name it and is taken for {holds.modes[0]}"
    if not holds.threshold and threshold != ALPHA_THRESHOLD:
        yield f"the threshold τ = {threshold:.4g}: {name} cannot name it"
    if not holds.lossless:
        yield f"precision: {name} rounds values to steps of its own"
