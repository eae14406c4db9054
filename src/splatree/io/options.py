"""What a caller may ask of every reader."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadOptions:
    """How a file is read."""

    level: int | None = None
    """Level of detail to read from a format that has several, 0 the finest; None: 0. An error for other formats."""
    repair: bool = False
    """Fix or drop what is wrong by the rules of `splatree.io.check`, and count it, instead of raising."""
