"""How a tree is refined."""

from dataclasses import dataclass
from typing import Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals

__all__ = ["RefineOptions", "Teacher"]

Teacher = Literal["same", "large"]
"""What inner nodes learn from: `same`, all leaves drawn at the size of the view; `large`, all leaves drawn four times larger
along each side and averaged down, which is nearer to the truth where leaves are smaller than a pixel."""


@dataclass(frozen=True)
class RefineOptions:
    """How inner nodes learn what the leaves below them look like.

    Example:
        >>> st.RefineOptions(iterations=500).teacher
        'same'
    """

    minutes: float = 1.0
    """Minutes of processor time for all of it. The number of steps is fixed after the first 20 are timed."""
    iterations: int | None = None
    """Number of steps, instead of minutes: the same number gives the same bits on the same processor."""
    teacher: Teacher = "same"
    """`same`: all leaves as they are drawn at the view's size; `large`: drawn four times larger and averaged down, better where
    the mode `classic` makes small leaves too large."""
    made_views: int = 256
    """Views that are made to learn from, where no cameras are given; every eighth is kept to judge by. With few views nodes learn
    these instead of what they stand for."""
    finest: float = 3.0
    """Smallest τ_R, px, of the cuts that learn."""
    coarsest: float = 20.0
    """Largest τ_R, px."""
    rate: float = 1.0
    """Factor on all rates."""
    seed: int = 0
    """Of the views, and of the order in which they are learned from."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 0 < self.minutes < 1e6:
            raise InputError(f"minutes: found {self.minutes}, wanted more than 0")
        if self.iterations is not None and not 1 <= self.iterations <= 10**9:
            raise InputError(f"iterations: found {self.iterations}, wanted 1 to 1e9")
        if not 8 <= self.made_views <= 10**6:
            raise InputError(f"made_views: found {self.made_views}, wanted 8 to 1e6")
        if not 0 < self.finest <= self.coarsest < float("inf"):
            raise InputError(f"finest, coarsest: found {self.finest}, {self.coarsest}, wanted 0 < finest <= coarsest")
        if not 0 < self.rate <= 100:
            raise InputError(f"rate: found {self.rate}, wanted more than 0, at most 100")
        if self.seed < 0:
            raise InputError(f"seed: found {self.seed}, wanted 0 or more")
