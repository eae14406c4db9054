"""The index of pages as it is stored: ``pages.index`` of a folder of parts, or the column ``pages`` of one ``.splatree``.

Either is a container of columns like a ``.splatree``. The column is behind all others, so it is made when they are written. Each
page is held against its checksum when it is read, so an index of other rows is noticed there. The column has a checksum of its
own. A box that was made too small is not noticed: `check` makes the index anew.

The manifest of a folder has the digest, so it is the one that was written with the parts. What an index says is held against the
files all the same: no page lies outside of its file, no number leads outside of a column.

Files of before have no steps of blocks but `block_leaf_scales`, and boxes of the crown that hold what is below its portals. They
are read as they are: views read more pages.
"""

import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splatree.constants import BLOCK_STEPS
from splatree.errors import FormatError, ShapeError
from splatree.io import untrusted
from splatree.io.formats.splatree.container import (
    Container,
    append_bytes,
    container_in,
    header_bytes,
    open_container,
    placed,
)
from splatree.io.formats.splatree.fields import PAGES
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import StoredScene, open_scene
from splatree.io.pages.index import StoreIndex, index_of_file
from splatree.io.pages.table import PageTable, table_of
from splatree.io.replacing import replacing
from splatree.progress import task
from splatree.shapes import Array

__all__ = ["INDEX", "append_index", "read_index", "read_own_index", "wants_index", "write_index"]

INDEX = "pages.index"
"""Name of the file."""

INDEXED_ROWS = 100_000
"""Rows from which on a file with levels has an index: that of fewer is made in a tenth of a second when the file is opened."""

NUMBERS = ("num_rows", "num_leaves", "num_levels", "num_roots", "largest_id")
COLUMNS = ("file_start", "plain_checksums", "drawn_checksums")
OF_PARTS = ("whole_rows", "above_start", "above")
"""Columns of a folder alone."""

ABOVE = ("above_start", "above")
STEPS = ("table.block_step_extents", "table.block_step_scales")
LEAF_SCALES = "table.block_leaf_scales"
"""In files of before, in place of the steps."""


def write_index(index: StoreIndex, path: Path) -> None:
    """Write the index of a folder, whole or not at all."""
    with replacing(path, force=True) as temporary:
        temporary.write_bytes(_bytes_of(index))


def wants_index(head: SceneHead) -> bool:
    """Whether a file has levels and is large enough for an index."""
    return head.record is not None and head.num_rows >= INDEXED_ROWS


def append_index(path: Path) -> None:
    """Index a ``.splatree`` that was just written, with room in its header, and add the index to it.

    Raises:
        FormatError: the rows are no tree.
    """
    stored = open_scene(path)
    with task("index pages", float(len(stored))) as advance:
        index = index_of_file(table_of(stored, checksums=True, advance=advance), len(stored))
    del stored  # no system has to write to a file that is mapped
    append_bytes(path, PAGES, _bytes_of(index))


def _bytes_of(index: StoreIndex) -> bytes:
    columns: dict[str, Array] = {f"table.{f.name}": getattr(index.table, f.name) for f in fields(PageTable)}
    columns |= {name: getattr(index, name) for name in (*COLUMNS, *(OF_PARTS if index.has_parts else ()))}
    places = placed({name: (column.dtype, column.shape) for name, column in columns.items()})
    values = {"kind": "pages", "numbers": json.dumps({name: getattr(index, name) for name in NUMBERS})}
    data = b"".join(np.ascontiguousarray(columns[name]).tobytes() for name in places)
    values["checksum"] = _checksum(values["numbers"], data)
    return header_bytes(values, places) + data


def _checksum(numbers: str, data: bytes | memoryview) -> str:
    """CRC-32 of all that an index says."""
    return f"{zlib.crc32(data, zlib.crc32(numbers.encode())):08x}"


def read_index(path: Path, files: Sequence[StoredScene]) -> StoreIndex:
    """Map the index of a folder and hold it against the files.

    Args:
        path: the index.
        files: the crown and the parts.

    Raises:
        FormatError: it is damaged or not that of these files.
    """
    return _index_in(open_container(path), path, files, OF_PARTS)


def read_own_index(stored: StoredScene) -> StoreIndex | None:
    """The index in a ``.splatree``, held against it; None: it has none.

    Raises:
        FormatError: it is damaged or not that of this file.
    """
    if PAGES not in stored.file.columns:
        return None
    path, column = stored.file.path, stored.file.rows(PAGES)
    if column.dtype != np.uint8 or column.ndim != 1:
        raise FormatError(
            f"{path}: {PAGES}: found {column.dtype} of shape {column.shape}, wanted bytes; the file is damaged"
        )
    remedy = f"splatree convert {path} whole.splatree makes the index anew"
    try:
        container = container_in(column, Path(PAGES))
        numbers, said = (untrusted.text(container.values, key, PAGES) for key in ("numbers", "checksum"))
    except FormatError as error:
        raise FormatError(f"{path}: column {error}: {remedy}") from error
    start = min((place.start for place in container.columns.values()), default=len(column))
    if said != (found := _checksum(numbers, column[start:].data)):
        raise FormatError(f"{path / PAGES}: found checksum {found}, wanted {said}; the file is damaged: {remedy}")
    return _index_in(container, path / PAGES, [stored], ())


def _index_in(container: Container, path: Path, files: Sequence[StoredScene], of_parts: tuple[str, ...]) -> StoreIndex:
    where = str(path)
    if container.values.get("kind") != "pages":
        raise FormatError(f"{where}: found kind {container.values.get('kind')!r}, wanted 'pages'")
    said = untrusted.as_object(
        untrusted.parse_json(untrusted.text(container.values, "numbers", where).encode(), where), where
    )
    high = {"num_levels": 256, "largest_id": 2**32 - 1}
    numbers: dict[str, Any] = {
        name: untrusted.integer(said, name, f"{where}: numbers", high=high.get(name, 2**31 - 1)) for name in NUMBERS
    }
    try:
        names, wanted = [f"table.{f.name}" for f in fields(PageTable)], [*COLUMNS, *of_parts]
        is_of_before = LEAF_SCALES in container.columns
        if is_of_before:
            names = [name for name in names if name not in STEPS] + [LEAF_SCALES]
            wanted = [name for name in wanted if name not in ABOVE]
        missing = [name for name in (*names, *wanted) if name not in container.columns]
        if missing:
            raise FormatError(
                f"{where}: found no column {missing[0]!r}; the file is damaged or of an older version: build again"
            )
        columns: dict[str, Any] = dict(zip((*names, *wanted), container.rows_of([*names, *wanted]), strict=True))
        if is_of_before:
            one_step = columns.pop(LEAF_SCALES).reshape(-1, 1)
            columns |= dict(zip(STEPS, (np.zeros_like(one_step), one_step), strict=True))
        table = PageTable(**{f.name: columns.pop(f"table.{f.name}") for f in fields(PageTable)})
        index = StoreIndex(table, **columns, **numbers)
    except ShapeError as error:
        raise FormatError(f"{where}: {error}; the file is damaged") from error
    steps, wanted_steps = table.block_step_extents.shape[1], 1 if is_of_before else BLOCK_STEPS
    if steps != wanted_steps:
        raise FormatError(
            f"{where}: {STEPS[0]}: found {steps} steps of a block, wanted {wanted_steps}; the file is damaged or of another "
            "version"
        )
    wrong = next(_wrong(index, [len(file) for file in files]), None)
    if wrong is not None:
        raise FormatError(f"{where}: {wrong}; the file is damaged or of another build")
    return index


def _wrong_numbers(index: StoreIndex, num_rows: int) -> Iterator[str]:
    """What is wrong with the numbers of an index of files of so many rows together, copies of roots among them."""
    if not index.has_parts and index.num_roots:
        yield f"num_roots: found {index.num_roots} in a file without parts, wanted 0"
    if index.num_rows != num_rows - index.num_roots:
        yield f"num_rows: found {index.num_rows}, wanted {num_rows - index.num_roots} as in the rows of the files"
    least = min(index.num_rows, 1)
    if not least <= index.num_levels <= index.num_rows:
        yield f"num_levels: found {index.num_levels}, wanted {least} to {index.num_rows}"
        return
    num_above = int(np.diff(index.table.ancestor_start).max(initial=0))
    if index.num_levels <= num_above:
        yield f"num_levels: found {index.num_levels}, wanted more than the {num_above} above a page"
    fewest = -(-index.num_rows // max(index.num_levels, 1))  # each row is a leaf or above one, at one of its levels
    if not fewest <= index.num_leaves <= index.num_rows:
        yield f"num_leaves: found {index.num_leaves}, wanted {fewest} to {index.num_rows}"


def _wrong(index: StoreIndex, num_rows: Sequence[int]) -> Iterator[str]:
    """What is wrong with an index of files of so many rows."""
    table, start = index.table, index.file_start
    yield from _wrong_numbers(index, sum(num_rows))
    if len(start) != len(num_rows) + 1 or start[0] != 0 or start[-1] != len(table) or np.any(np.diff(start) < 0):
        yield f"file_start: found {len(start) - 1} files with {len(table)} pages, wanted {len(num_rows)}"
        return
    firsts, lasts = np.zeros(len(table), bool), np.zeros(len(table), bool)
    has_pages = np.diff(start) > 0
    firsts[start[:-1][has_pages]], lasts[start[1:][has_pages] - 1] = True, True
    rows_of_page = np.repeat(np.asarray(num_rows), np.diff(start))
    if (
        np.any(has_pages != (np.asarray(num_rows) > 0))
        or np.any(table.begin >= table.end)
        or np.any(table.begin != np.where(firsts, 0, np.roll(table.end, 1)))
        or np.any(lasts & (table.end != rows_of_page))
    ):
        yield "table: found pages that do not follow each other from the first row of each file to the last"
    elif len(table.block_lower) != table.block_start[-1]:
        yield f"table: found {len(table.block_lower)} blocks, wanted {table.block_start[-1]}"
    ancestor_start, c = table.ancestor_start, len(table.rows)
    if (
        ancestor_start[0] != 0
        or ancestor_start[-1] != len(table.ancestors)
        or np.any(np.diff(ancestor_start) < 0)
        or np.any((table.ancestors < 0) | (table.ancestors >= c))
    ):
        yield "table: found ancestors that are not there"
        return
    of_page = np.repeat(np.arange(len(table)), np.diff(ancestor_start))
    begin = table.begin[of_page]
    if np.any(table.rows[table.ancestors] >= begin) or np.any(table.subtree_end[table.ancestors] <= begin):
        yield "table: found ancestors that do not hold their page"
    if not index.has_parts:
        return
    own = index.num_own
    roots, whole = table.first_root[own:], index.whole_rows
    if np.any(np.diff(roots) < 0) or np.any((roots < 0) | (roots > index.num_roots)):
        yield f"table: found roots that are not numbered from 0 to {index.num_roots}"
    if index.above_start is not None and index.above is not None:
        if (
            index.above_start[0] != 0
            or index.above_start[-1] != len(index.above)
            or np.any(np.diff(index.above_start) < 0)
        ):
            yield f"above_start: found no ascending places of {len(index.above)} pages of the crown"
        elif np.any((index.above < 0) | (index.above >= own)):
            yield f"above: found pages that are not among the {own} of the crown"
    if whole is None or len(whole) != num_rows[0] or np.any(np.diff(whole) <= 0) or np.any(whole[:1] != 0):
        yield f"whole_rows: found no ascending rows of the {num_rows[0]} nodes of the crown"
    elif len(whole) and whole[-1] >= index.num_rows:
        yield f"whole_rows: found row {whole[-1]}, wanted less than {index.num_rows}"
    if index.largest_id + index.num_rows >= 2**32:
        yield f"largest_id: found {index.largest_id}, which leaves no room for merged nodes"
