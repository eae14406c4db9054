"""What a store knows of its files before it reads a page: the table of pages, and where each row stands in the whole tree."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from splatree.constants import BLOCK_ROWS
from splatree.errors import FormatError, InputError, ShapeError
from splatree.io.formats.splatree.rows import StoredScene
from splatree.outofcore.page import HARMONIC_ROWS, Checksums
from splatree.outofcore.pages import FilePages, PageTable, table_of
from splatree.shapes import Array, Int32, UInt32, check_fields

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
    plain_checksums: UInt32[Array, "p"] | None = None
    """`Checksums.plain` of each page; None: not known."""
    block_checksums: UInt32[Array, "h"] | None = None
    """`Checksums.harmonics` of all pages, one after the other; None: not known."""

    _block_start: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields(self, p=len(self.table), f=len(self.file_start) - 1)
        num_blocks = -(-(self.table.end - self.table.begin) // HARMONIC_ROWS)
        object.__setattr__(self, "_block_start", np.concatenate([[0], np.cumsum(num_blocks)]))
        if self.block_checksums is not None and len(self.block_checksums) != self._block_start[-1]:
            raise ShapeError(
                f"StoreIndex: found {len(self.block_checksums)} checksums of blocks, wanted {self._block_start[-1]}"
            )

    def checksums_of(self, page: int) -> Checksums | None:
        """Those of a page; None: not known."""
        if self.plain_checksums is None or self.block_checksums is None:
            return None
        blocks = slice(self._block_start[page], self._block_start[page + 1])
        return Checksums(int(self.plain_checksums[page]), self.block_checksums[blocks])

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


def index_of_file(stored: StoredScene, advance: Callable[[float], None]) -> StoreIndex:
    """Go through a file and index it; ``advance`` is told of rows gone through.

    Raises:
        FormatError: a value cannot be used, or the rows are no tree.
    """
    found = table_of(stored, advance=advance)
    start = np.array([0, len(found.table)], np.int32)
    levels = int(found.root_levels.max()) + 1 if len(stored) else 0
    return StoreIndex(found.table, start, len(stored), found.num_leaves, levels, 0, found.largest_id)


def index_of_folder(crown: StoredScene, own: FilePages, pages: Sequence[FilePages], where: Path) -> StoreIndex:
    """The index of a folder from what was found in its files.

    Args:
        crown: the nodes above the parts.
        own: what `table_of` found in the crown.
        pages: what it found in each part, in their order.
        where: the folder, for errors.

    Raises:
        FormatError: the parts are not those of the crown.
        InputError: there are 2³¹ rows or more.
    """
    num_roots = sum(len(part.root_sizes) for part in pages)
    copies, roots = _copies(crown, num_roots, own.num_leaves, where)
    num_rows_of = np.ones(len(crown), np.int64)
    num_rows_of[copies] = np.concatenate([part.root_sizes for part in pages])[roots]
    levels = np.concatenate([part.root_levels for part in pages])[roots].astype(np.int32)
    first_row = np.concatenate([[0], np.cumsum(num_rows_of)])
    largest_id = max((part.largest_id for part in pages), default=-1)
    if first_row[-1] >= 2**31 or largest_id + first_row[-1] >= 2**32:
        raise InputError(
            f"{where}: found {first_row[-1]} rows and identities of leaves up to {largest_id}, wanted less than 2^31 rows, and "
            "less than 2^32 identities together"
        )
    table = PageTable.joined([own.table, *_numbered(pages)])
    noted = [checksums for part in (own, *pages) for checksums in part.checksums]
    has_checksums = len(noted) == len(table)
    return StoreIndex(
        table=_widened(table, len(own.table), copies, roots, pages),
        file_start=np.cumsum([0, len(own.table), *(len(part.table) for part in pages)]).astype(np.int32),
        num_rows=int(first_row[-1]),
        num_leaves=sum(part.num_leaves for part in pages),
        num_levels=int((crown.file.rows("tree.depth")[copies] + levels).max()) + 1,
        num_roots=num_roots,
        largest_id=largest_id,
        whole_rows=first_row[:-1].astype(np.int32),
        plain_checksums=np.array([each.plain for each in noted], np.uint32) if has_checksums else None,
        block_checksums=np.concatenate([each.harmonics for each in noted]) if has_checksums else None,
    )


def _copies(crown: StoredScene, num_roots: int, num_leaves: int, where: Path) -> tuple[Array, Array]:
    """The rows of the crown that are copies of roots of parts, ascending, and the number of each root."""
    if not crown.head.has_ids:
        raise FormatError(f"{crown.file.path}: found no ids, wanted the numbers of the roots of all parts")
    copies = np.flatnonzero(crown.file.rows("tree.subtree_end") == np.arange(1, len(crown) + 1))
    roots = crown.file.rows("ids")[copies]
    if num_leaves != num_roots or not np.array_equal(np.sort(roots), np.arange(num_roots)):
        raise FormatError(
            f"{where}: found {num_roots} roots in the parts and {num_leaves} leaves in the crown, wanted a copy of each root; "
            "the files are of different builds"
        )
    return copies, roots


def _numbered(pages: Sequence[FilePages]) -> list[PageTable]:
    """The tables of the parts, with roots numbered through all of them."""
    first = np.cumsum([0, *(len(part.root_sizes) for part in pages)])
    return [
        replace(part.table, first_root=part.table.first_root + number)
        for part, number in zip(pages, first[:-1], strict=True)
    ]


def _widened(table: PageTable, num_own: int, copies: Array, roots: Array, pages: Sequence[FilePages]) -> PageTable:
    """The table in which the pages of the crown, and their blocks, hold what is below their portals."""
    page = np.searchsorted(table.begin[:num_own], copies, side="right") - 1
    block = table.block_start[page] + (copies - table.begin[page]) // BLOCK_ROWS
    widened = {}
    for name, bound in (("lower", np.minimum), ("upper", np.maximum), ("scales", np.maximum)):
        of_roots = np.concatenate([getattr(part, f"root_{name}") for part in pages])[roots]
        column = f"leaf_{name}" if name == "scales" else name
        for kind, place in ((column, page), (f"block_{column}", block)):
            widened[kind] = getattr(table, kind).copy()
            bound.at(widened[kind], place, of_roots)
    return replace(table, **widened)
