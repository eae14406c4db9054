"""What a store knows of its files before it reads a page: the table of pages, and where each row stands in the whole tree."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from splatree.errors import FormatError, InputError, ShapeError
from splatree.io.chunks import ROWS_PER_CHUNK
from splatree.io.formats.splatree.rows import StoredScene
from splatree.io.pages.page import DRAWN_ROWS, Checksums
from splatree.io.pages.table import FilePages, PageTable
from splatree.shapes import Array, Int32, Int64, UInt32, check_fields

__all__ = ["StoreIndex", "index_of_file", "index_of_folder"]


@dataclass(frozen=True, eq=False)
class StoreIndex:
    """The pages of all files of a store; the first file is the crown, or the only one."""

    table: PageTable
    """Pages, file by file."""
    file_start: Int32[Array, "f+1"]
    """Pages of file ``i``: ``file_start[i]`` to ``file_start[i + 1]``."""
    num_rows: int
    """Rows of the whole tree."""
    num_leaves: int
    """Leaves of the whole tree."""
    num_levels: int
    """Largest depth of the whole tree + 1; 0 for an empty one."""
    num_roots: int
    """Roots of parts; 0 without parts."""
    largest_id: int
    """Largest identity of a leaf."""
    whole_rows: Int32[Array, "c"] | None = None
    """Row in the whole tree of each row of the crown; None: there are no parts."""
    above_start: Int32[Array, "p+1"] | None = None
    """Pages of the crown that hold copies of the roots that page ``i`` belongs to:
    ``above[above_start[i] : above_start[i + 1]]``. None: there are no parts, or the boxes of the crown hold what is below its
    portals, as in folders of before."""
    above: Int32[Array, "x"] | None = None
    """Numbers of these pages, ascending for each page."""
    plain_checksums: UInt32[Array, "p"] | None = None
    """`Checksums.plain` of each page; None: not known."""
    drawn_checksums: UInt32[Array, "h"] | None = None
    """`Checksums.drawn` of all pages, one after the other; None: not known."""

    _run_start: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields(self, p=len(self.table), f=len(self.file_start) - 1)
        num_runs = -(-(self.table.end - self.table.begin) // DRAWN_ROWS)
        object.__setattr__(self, "_run_start", np.concatenate([[0], np.cumsum(num_runs)]))
        if self.drawn_checksums is not None and len(self.drawn_checksums) != self._run_start[-1]:
            raise ShapeError(
                f"StoreIndex: found {len(self.drawn_checksums)} checksums of runs, wanted {self._run_start[-1]}"
            )

    def checksums_of(self, page: int) -> Checksums | None:
        """Those of a page; None: not known."""
        if self.plain_checksums is None or self.drawn_checksums is None:
            return None
        runs = slice(self._run_start[page], self._run_start[page + 1])
        return Checksums(int(self.plain_checksums[page]), self.drawn_checksums[runs])

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        columns = [*vars(self).values(), *vars(self.table).values()]
        return sum(column.nbytes for column in columns if isinstance(column, np.ndarray))

    @property
    def num_own(self) -> int:
        """Pages of the first file."""
        return int(self.file_start[1])

    @property
    def has_parts(self) -> bool:
        """Whether the leaves of the first file are copies of roots of parts."""
        return self.whole_rows is not None

    def file_of(self, page: int) -> int:
        """The file that a page is in."""
        return int(np.searchsorted(self.file_start, page, side="right")) - 1


def index_of_file(found: FilePages, num_rows: int) -> StoreIndex:
    """The index of a file of so many rows from what `table_of` found in it."""
    start = np.array([0, len(found.table)], np.int32)
    levels = int(found.root_levels.max()) + 1 if num_rows else 0
    return StoreIndex(
        table=found.table,
        file_start=start,
        num_rows=num_rows,
        num_leaves=found.num_leaves,
        num_levels=levels,
        num_roots=0,
        largest_id=found.largest_id,
        **(_checksums(found.checksums) if found.checksums else {}),
    )


def _checksums(noted: Sequence[Checksums]) -> dict[str, UInt32[Array, "x"]]:
    plain = np.array([each.plain for each in noted], np.uint32)
    return {"plain_checksums": plain, "drawn_checksums": np.concatenate([each.drawn for each in noted])}


def index_of_folder(crown: StoredScene, own: FilePages, pages: Iterable[FilePages], where: Path) -> StoreIndex:
    """The index of a folder from what was found in its files.

    Args:
        crown: the nodes above the parts.
        own: what `table_of` found in the crown.
        pages: what it finds in each part, in their order; one is held at a time, but for its table.
        where: the folder, for errors.

    Raises:
        FormatError: the parts are not those of the crown.
        InputError: there are 2³¹ rows or more.

    Memory: 12 bytes a row of the crown, and the index.
    """
    copies = _copies(crown, own.num_leaves)
    sizes = np.ones(len(crown), np.int32)
    tables, noted, above = [own.table], list(own.checksums), [np.zeros(0, np.int32)] * len(own.table)
    num_roots = num_leaves = num_levels = 0
    largest_id = -1
    depth = crown.file.rows("tree.depth")
    for part in pages:
        of_part = copies[num_roots : num_roots + len(part.root_sizes)]
        if len(of_part) < len(part.root_sizes):
            raise _of_different_builds(where, f"more than {num_roots + len(of_part)}", own.num_leaves)
        sizes[of_part] = part.root_sizes
        above += _pages_above(part.table, np.searchsorted(own.table.begin, of_part, side="right") - 1)
        tables.append(replace(part.table, first_root=part.table.first_root + num_roots))
        noted += part.checksums
        num_roots, num_leaves = num_roots + len(of_part), num_leaves + part.num_leaves
        deepest = int((depth[of_part] + part.root_levels.astype(np.int32)).max(initial=-1))
        num_levels, largest_id = max(num_levels, deepest + 1), max(largest_id, part.largest_id)
    if num_roots != own.num_leaves:
        raise _of_different_builds(where, str(num_roots), own.num_leaves)
    num_rows = int(sizes.sum(dtype=np.int64))
    if num_rows >= 2**31 or largest_id + num_rows >= 2**32:
        raise InputError(
            f"{where}: found {num_rows} rows and identities of leaves up to {largest_id}, wanted less than 2^31 rows, and less "
            "than 2^32 identities together"
        )
    table = PageTable.joined(tables)
    return StoreIndex(
        table=table,
        file_start=np.cumsum([0, *map(len, tables)]).astype(np.int32),
        num_rows=num_rows,
        num_leaves=num_leaves,
        num_levels=num_levels,
        num_roots=num_roots,
        largest_id=largest_id,
        whole_rows=np.cumsum(sizes, dtype=np.int32) - sizes,
        above_start=np.cumsum([0, *map(len, above)]).astype(np.int32),
        above=np.concatenate(above).astype(np.int32),
        **(_checksums(noted) if len(noted) == len(table) else {}),
    )


def _pages_above(table: PageTable, page_of_root: Int64[Array, "r"]) -> list[Int32[Array, "x"]]:
    """For each page of a part, the pages of the crown that hold copies of its roots, given that of each root."""
    if not len(table):
        return []
    # A page belongs to the roots that begin in it, and to the one before if it begins within a subtree.
    first = table.first_root - (np.diff(table.ancestor_start) > 0)
    last = np.append(table.first_root[1:], len(page_of_root))
    return [np.unique(page_of_root[i:j]).astype(np.int32) for i, j in zip(first, last, strict=True)]


def _copies(crown: StoredScene, num_leaves: int) -> Int32[Array, "r"]:
    """The row of the crown of the copy of each root of a part, by the number of the root."""
    path = crown.file.path
    if not crown.head.has_ids:
        raise FormatError(f"{path}: found no ids, wanted the numbers of the roots of all parts")
    rows = np.full(num_leaves, -1, np.int32)
    for begin in range(0, len(crown), ROWS_PER_CHUNK):
        ends = crown.file.rows("tree.subtree_end", begin, begin + ROWS_PER_CHUNK)
        leaves = np.flatnonzero(ends == np.arange(begin + 1, begin + 1 + len(ends)))
        numbers = crown.file.rows("ids", begin, begin + len(ends))[leaves]
        if numbers.max(initial=0) >= max(num_leaves, 1):
            break
        rows[numbers] = begin + leaves
    if num_leaves and rows.min() < 0:
        raise FormatError(f"{path}: found ids of leaves that are not 0 to {num_leaves - 1}; the file is damaged")
    return rows


def _of_different_builds(where: Path, num_roots: str, num_leaves: int) -> FormatError:
    return FormatError(
        f"{where}: found {num_roots} roots in the parts and {num_leaves} leaves in the crown, wanted a copy of each root; the "
        "files are of different builds"
    )
