"""A tree that is read in runs of rows: what formats with levels give of a file larger than memory.

`splatree.io.tree_runs` opens, edits and writes one.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows

__all__ = ["TreeRuns"]


@dataclass(frozen=True, eq=False)
class TreeRuns:
    """A tree whose rows come in runs, as often as they are asked for."""

    head: SceneHead
    """How many rows there are, and how they are drawn."""
    num_leaves: int
    """Leaves."""
    runs: Callable[[str], Iterator[SceneRows]]
    """All rows in order, a run at a time; the text names the work for who watches it."""

    has_more: bool = False
    """Whether the file holds more than its rows and the state of its roots: clusters, which runs do not carry."""

    def __len__(self) -> int:
        return self.head.num_rows
