"""``pages.index``: the index of a folder of parts as a file, a container of columns like a ``.splatree``.

The manifest has its digest, so it is the one that was written with the parts. What it says is held against the files all the
same: no page lies outside of its file, no number leads outside of a column.

Files of before have no steps of blocks but `block_leaf_scales`, and boxes of the crown that hold what is below its portals. They
are read as they are: views read more pages.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import FormatError, ShapeError
from splatree.io import untrusted
from splatree.io.formats.splatree.container import header_bytes, open_container, placed
from splatree.io.formats.splatree.rows import StoredScene
from splatree.io.replacing import replacing
from splatree.outofcore.index import StoreIndex
from splatree.outofcore.pages import PageTable
from splatree.shapes import Array

__all__ = ["INDEX", "read_index", "write_index"]

INDEX = "pages.index"
"""Name of the file."""

NUMBERS = ("num_rows", "num_leaves", "num_levels", "num_roots", "largest_id")
COLUMNS = ("file_start", "whole_rows", "above_start", "above", "plain_checksums", "drawn_checksums")

ABOVE = ("above_start", "above")
STEPS = ("table.block_step_extents", "table.block_step_scales")
LEAF_SCALES = "table.block_leaf_scales"
"""In files of before, in place of the steps."""


def write_index(index: StoreIndex, path: Path) -> None:
    """Write the index of a folder, whole or not at all."""
    columns: dict[str, Array] = {f"table.{f.name}": getattr(index.table, f.name) for f in fields(PageTable)}
    columns |= {name: getattr(index, name) for name in COLUMNS}
    places = placed({name: (column.dtype, column.shape) for name, column in columns.items()})
    values = {"kind": "pages", "numbers": json.dumps({name: getattr(index, name) for name in NUMBERS})}
    with replacing(path, force=True) as temporary, temporary.open("wb") as file:
        file.write(header_bytes(values, places))
        for name in places:
            file.write(np.ascontiguousarray(columns[name]).tobytes())


def read_index(path: Path, files: Sequence[StoredScene]) -> StoreIndex:
    """Map the index of a folder and hold it against the files.

    Args:
        path: the index.
        files: the crown and the parts.

    Raises:
        FormatError: it is damaged or not that of these files.
    """
    where, container = str(path), open_container(path)
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
        names, wanted = [f"table.{f.name}" for f in fields(PageTable)], [*COLUMNS]
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
    wrong = next(_wrong(index, [len(file) for file in files]), None)
    if wrong is not None:
        raise FormatError(f"{where}: {wrong}; the file is damaged or of another build")
    return index


def _wrong(index: StoreIndex, num_rows: Sequence[int]) -> Iterator[str]:
    """What is wrong with an index of files of so many rows."""
    table, start = index.table, index.file_start
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
