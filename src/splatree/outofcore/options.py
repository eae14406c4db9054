"""How much memory a build through files takes, and how the memory is spent."""

import math
from dataclasses import dataclass

from splatree.errors import InputError
from splatree.io.memory import PROCESS_BYTES, SMALLEST_MEMORY, bytes_of, free_bytes
from splatree.scene.literals import check_literals

__all__ = ["FolderOptions", "Room"]

ROW_BYTES = 420
"""What growing a cell takes for each of its rows without harmonics, with the space around it: benchmarks/scale.py."""

FOLLOWING_BYTES = 200
"""What it takes besides where merged Gaussians follow the pixel: moments and curves. By pairs it is counted in."""

ROOT_ROW_BYTES = 650
"""What growing a cell of roots of parts takes for each of its rows: they carry weights, ranks and balls."""

HARMONIC_BYTES = 22
"""What it takes besides for each coefficient of harmonics above degree 0, three floats."""

ROOT_BYTES = 450
"""What growing roots of parts together takes for each of them without harmonics: benchmarks/scale.py."""

ROOT_HARMONIC_BYTES = 45
"""What they take besides for each coefficient of harmonics above degree 0."""

ROOT_SHOWN_BYTES = 1000
"""What it takes besides where nodes follow the pixel: what leaves show at the pixel of each level."""

MOST_LEVELS = 16
"""Levels that a user may let cells grow: what has to be loaded around a cell doubles with each."""

PART_ROWS = 1_000_000
"""Rows of a cell where memory allows: larger cells load less around them, smaller ones are done sooner."""

PART_LEVELS = 3
"""Levels by a radius that cells grow: radii double, and with them what has to be loaded around a cell."""

PAIR_CELL_ROWS = 1 << 18
"""Rows of a cell where levels are made by pairs, whatever the memory: the tree depends on the cells."""

PAIR_ROW_BYTES = 550
"""What growing a cell by pairs takes for each of its rows without harmonics: benchmarks/scale.py."""

MOST_WORKERS = 1_024
"""Processes of one machine: a number that was meant to be another one must not start as many."""

FEWEST_ROWS = 1_000
"""The smallest cell: below it, what is loaded around a cell is most of it."""


@dataclass(frozen=True)
class FolderOptions:
    """How a build through files is run. None of it changes levels by a radius; the size of parts changes levels by pairs.

    Example:
        >>> running = st.FolderOptions(max_memory="1G", part_rows=100)
        >>> st.build_folder("city.ply", "parts.splatree", running=running).num_parts > 1
        True
    """

    max_memory: str | None = None
    """Most memory for all processes of this machine together, and for each cell on a worker of a cluster: 4G, 500M; None: half of
    what is free."""
    workers: int = 1
    """Processes that grow cells at the same time; 1: this process alone."""
    scheduler: str | None = None
    """Grow cells on the workers of a Dask cluster, which see the same files: the address of its scheduler, such as
    tcp://10.0.0.5:8786; None: on this machine."""
    part_rows: int | None = None
    """Rows of a cell; None: a million, or as many as memory allows. The files depend on it, the tree does not. For levels by
    pairs, which depend on the cells: 262,144."""
    part_levels: int | None = None
    """Levels that cells grow, before what is left is cut into cells anew, or grown in one piece where it fits in memory. None:
    for levels by a radius 3; for levels by pairs until a sixteenth of a cell is left, and then in one piece."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 1 <= self.workers <= MOST_WORKERS:
            raise InputError(f"workers: found {self.workers}, wanted 1 to {MOST_WORKERS}")
        if self.workers > 1 and self.scheduler is not None:
            raise InputError(
                f"workers: found {self.workers} processes of this machine and a scheduler, wanted one of them: a cluster has its "
                "own workers"
            )
        if self.part_rows is not None and self.part_rows < 1:
            raise InputError(f"part_rows: found {self.part_rows}, wanted at least 1")
        if self.part_levels is not None and not 1 <= self.part_levels <= MOST_LEVELS:
            raise InputError(f"part_levels: found {self.part_levels}, wanted 1 to {MOST_LEVELS}")
        if self.max_memory is not None and bytes_of(self.max_memory) < SMALLEST_MEMORY:
            raise InputError(f"max_memory: found {self.max_memory}, wanted at least {SMALLEST_MEMORY // 10**6}M")


@dataclass(frozen=True)
class Room:
    """How the memory is spent."""

    max_bytes: int
    """All of it."""
    part_rows: int
    """Rows of a cell."""
    workers: int
    """Cells at the same time, on this machine."""
    piece_bytes: float
    """What one cell may take, here or on a worker of a cluster."""

    @staticmethod
    def of(
        options: FolderOptions,
        num_rows: int,
        num_coefficients: int,
        thread_bytes: float = math.inf,
        *,
        by_pairs: bool = False,
        follows: bool = False,
    ) -> "Room":
        """Cells of a million rows, or as many as fit, and as many at the same time as fit then.

        Args:
            options: what the user allows.
            num_rows: Gaussians of the scene: no cell has more.
            num_coefficients: of the harmonics.
            thread_bytes: what workers elsewhere have for a cell.
            by_pairs: levels are made by pairs, which depend on the cells: these do not follow the memory.
            follows: merged Gaussians follow the pixel that they are drawn at.

        Raises:
            InputError: these workers have too little.
        """
        max_bytes = free_bytes() // 2 if options.max_memory is None else bytes_of(options.max_memory)
        max_bytes = max(max_bytes, SMALLEST_MEMORY)
        if thread_bytes < SMALLEST_MEMORY:
            raise InputError(
                f"scheduler: found a worker with {thread_bytes / 1e6:.0f} MB for each of its threads, wanted at least "
                f"{SMALLEST_MEMORY // 10**6} MB; start it with fewer threads or more memory"
            )
        piece_bytes = min(max_bytes, thread_bytes)
        if by_pairs:
            rows = options.part_rows or PAIR_CELL_ROWS
            largest = min(rows, num_rows)
            cell = cell_bytes(largest, num_coefficients, by_pairs=True)
            if cell > piece_bytes:
                raise InputError(
                    f"max_memory: found {piece_bytes / 1e6:.0f} MB for a cell of {largest} Gaussians, wanted at least "
                    f"{cell // 10**6} MB to choose pairs in it; raise --max-memory, make levels with --method radius, or lower "
                    "--part-rows: levels by pairs depend on it"
                )
            return Room(max_bytes, rows, _beside(options, max_bytes, cell), piece_bytes)
        fitting = int((piece_bytes - PROCESS_BYTES) // row_bytes_of(num_coefficients, follows=follows))
        rows = options.part_rows or min(PART_ROWS, max(fitting, FEWEST_ROWS))
        cell = cell_bytes(min(rows, num_rows), num_coefficients, follows=follows)
        return Room(max_bytes, rows, _beside(options, max_bytes, cell), piece_bytes)


def _beside(options: FolderOptions, max_bytes: int, cell: int) -> int:
    """How many processes can work at the same time beside this one, which then only waits."""
    return max(1, min(options.workers, (max_bytes - PROCESS_BYTES) // cell))


def cell_bytes(num_rows: int, num_coefficients: int, *, by_pairs: bool = False, follows: bool = False) -> int:
    """Memory of a process that grows a cell."""
    return PROCESS_BYTES + num_rows * row_bytes_of(num_coefficients, by_pairs=by_pairs, follows=follows)


def row_bytes_of(num_coefficients: int, *, by_pairs: bool = False, follows: bool = False) -> int:
    """What growing a cell takes for each of its rows."""
    bare = PAIR_ROW_BYTES if by_pairs else ROW_BYTES + FOLLOWING_BYTES * follows
    return bare + HARMONIC_BYTES * (num_coefficients - 1)


def rows_above(part_rows: int) -> int:
    """Rows of a cell of roots that takes no more memory than one of so many leaves."""
    return max(1, part_rows * ROW_BYTES // ROOT_ROW_BYTES)


def top_bytes(num_roots: int, num_coefficients: int, *, follows: bool) -> int:
    """Memory of a process that grows roots of parts together."""
    root_bytes = ROOT_BYTES + ROOT_HARMONIC_BYTES * (num_coefficients - 1) + ROOT_SHOWN_BYTES * follows
    return PROCESS_BYTES + num_roots * root_bytes
