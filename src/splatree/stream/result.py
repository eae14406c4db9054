"""What was written."""

from dataclasses import dataclass, field
from pathlib import Path

from splatree.scene.literals import check_literals
from splatree.stream.options import StreamFormat, StreamOptions

__all__ = ["LevelWritten", "Streamed"]


@dataclass(frozen=True)
class LevelWritten:
    """One level of a stream."""

    level: int
    """0 is the finest."""
    num_nodes: int
    """Gaussians of the level."""
    size: float
    """Largest extent of a node that stands for others, world units; 0 for the leaves."""
    num_files: int
    """Units or tiles."""
    bytes: int
    """Size of them all."""


@dataclass(frozen=True)
class Streamed:
    """What `stream` wrote.

    Example:
        >>> written = st.stream(scene, "city.rad", "rad")
        >>> written.format, written.bytes > 0
        ('rad', True)
    """

    output: Path
    """The folder or the file."""
    format: StreamFormat
    """Format, which says who reads it."""
    num_chunks: int
    """Number of pieces for which a viewer chooses how fine to draw them."""
    levels: tuple[LevelWritten, ...]
    """The levels, finest first."""
    num_parts: int
    """Number of parts; each is a folder of pictures or a file."""
    num_parts_kept: int
    """Number of parts that were there already, from a run that was interrupted or had the same scene and options."""
    num_parts_damaged: int
    """Number of parts that were there, and did not hold any more what they were written with: they were made again."""
    bytes: int
    """Size of all files, bytes."""
    options: StreamOptions = field(default_factory=StreamOptions)
    """How it was cut."""

    def __post_init__(self) -> None:
        check_literals(self)
