"""Check a scene on disk: everything that a reader or a store may ever touch, with the memory of a page or a chunk.

What is drawn page by page is checked page by page, when it is touched. So a damaged page of a large scene may be met late.
`check` touches all: digests, values, trees, and the index of a folder, which is made anew and compared.
"""

import json
import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from splatree.errors import FormatError
from splatree.io.formats.folder.manifest import MANIFEST, holds_parts, read_manifest
from splatree.io.formats.folder.whole import open_whole
from splatree.io.formats.splatree.format import has_rows_alone, is_compact
from splatree.io.formats.splatree.rows import StoredScene, open_scene
from splatree.io.formats.tiles3d.format import check_all
from splatree.io.inputs import find_inputs
from splatree.io.joined_chunks import opened_chunks
from splatree.io.local import local_inputs
from splatree.io.options import ReadOptions
from splatree.io.pages.index import StoreIndex, index_of_file, index_of_folder
from splatree.io.pages.index_file import read_index, read_own_index
from splatree.io.pages.page import Page, page_of
from splatree.io.pages.table import FilePages, PageTable, table_of
from splatree.io.reading import read_one
from splatree.io.registry import detect, stored_bytes
from splatree.io.tree_runs import stored_runs
from splatree.progress import task, track
from splatree.scene.arguments import checked
from splatree.scene.given import given

__all__ = ["Checked", "check"]

BOXES_OF_BEFORE = {f.name for f in fields(PageTable) if f.name.startswith(("lower", "upper", "leaf", "block"))} | {
    *("above_start", "above")
}
"""What an index of before says in another way: its digest alone is checked."""


@dataclass(frozen=True)
class Checked:
    """What was checked, and is whole.

    Example:
        >>> (checked,) = st.check("city.ply")
        >>> checked.format, checked.num_gaussians
        ('ply', 253)
    """

    path: str
    """File or folder."""
    format: str
    """Name of the format."""
    num_gaussians: int
    """Gaussians that were not made by merging."""
    num_nodes: int
    """All rows, merged nodes and those of coarser tiles included."""
    num_bytes: int
    """Bytes of all files."""
    by_pages: bool
    """Whether it went through in pages or chunks, with bounded memory."""


@checked
def check(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], options: ReadOptions | None = None
) -> tuple[Checked, ...]:
    """Touch everything of scenes on disk, as no other call has to, and say what is wrong with the first that is damaged.

    A folder of parts and a ``.splatree`` are gone through page by page, other formats in chunks where they can be read so. Of 3D
    Tiles every tile is read, and an error names all that are damaged.

    Args:
        path: one file or folder, or several, each of which is checked by itself.
        options: how they are read; None: the defaults.

    Returns:
        What each holds.

    Raises:
        FormatError: a file does not hold what it promises; the message says where and what to do.
        InputError: nothing is there, or it is of no known format.

    Example:
        >>> [checked.num_gaussians for checked in st.check(["city.ply", "city.splatree"])]
        [253, 253]
    """
    options = given(options, ReadOptions, "check: options")
    with local_inputs(path) as local:
        found = find_inputs(local.paths, lambda p: detect(p) is not None)
        checked = [_checked(path, options) for path in found.paths]
        return tuple(replace(one, path=local.named(one.path)) for one in checked)


def _checked(path: Path, options: ReadOptions) -> Checked:
    found = detect(path)
    name = "" if found is None else found.name
    if name == "3d-tiles":
        tiles = check_all(path, options)
        return Checked(str(path), name, tiles.num_gaussians, tiles.num_rows, tiles.num_bytes, True)
    num_bytes = stored_bytes(path)
    if holds_parts(path):
        return Checked(str(path), name, *_folder(path), num_bytes, True)
    if name == "splatree" and not is_compact(path) and has_rows_alone(stored := open_scene(path)):
        index, pages = read_own_index(stored), _pages(stored, checksums=True)
        if index is not None and (field := _unlike(index_of_file(pages, len(stored)), index)) is not None:
            _check_pages(stored, index)  # rows that were damaged are another index's, too
            raise FormatError(
                f"{path}: found another {field} than that of the rows; splatree convert {path} whole.splatree makes the index "
                "anew"
            )
        return Checked(str(path), name, pages.num_leaves, len(stored), num_bytes, True)
    chunks = opened_chunks([path], options)
    if chunks is not None:
        counts = [sum(map(len, track(chunks[0], f"check {path.name}")))]
        if found is not None and found.holds.levels == "one of" and options.level is None:
            counts += _coarser(path, options, len(json.loads(chunks[0].metadata["level_counts"])))
        return Checked(str(path), name, counts[0], sum(counts), num_bytes, True)
    tree = None if options.repair or options.level is not None else stored_runs(path)
    if tree is not None and not tree.has_more:
        for _ in tree.runs(f"check {path.name}"):  # checks their values
            pass
        return Checked(str(path), name, tree.num_leaves, len(tree), num_bytes, True)
    scene = read_one(path, options)
    return Checked(str(path), name, scene.tree.num_leaves, len(scene), num_bytes, False)


def _coarser(path: Path, options: ReadOptions, num_levels: int) -> Iterator[int]:
    """Gaussians of each level above the finest, which are gone through."""
    for level in range(1, num_levels):
        for chunks in opened_chunks([path], replace(options, level=level)) or ():
            yield sum(map(len, track(chunks, f"check level {level} of {path.name}")))


def _pages(stored: StoredScene, *, portals: bool = False, checksums: bool = False) -> FilePages:
    """Go through a file with its harmonics."""

    def look(page: Page) -> None:
        page.check_drawn(np.arange(len(page), dtype=np.int32))

    with task(f"check {stored.file.path.name}", float(len(stored))) as advance:
        return table_of(stored, portals=portals, checksums=checksums, look=look, advance=advance)


def _folder(path: Path) -> tuple[int, int]:
    """The leaves and the rows of a folder."""
    tree = open_whole(path)
    for begin in range(0, len(tree), 1 << 17):  # too deep, where crown and part are put together
        tree.shape(begin, min(begin + (1 << 17), len(tree)))
    manifest, (crown, *parts) = read_manifest(path), tree.files
    if tree.num_leaves != manifest.num_leaves:
        raise FormatError(
            f"{path / MANIFEST}: found {tree.num_leaves} leaves in the files, wanted {manifest.num_leaves}"
        )
    wanted = index_of_folder(
        crown, _pages(crown, portals=True, checksums=True), (_pages(part, checksums=True) for part in parts), path
    )
    if manifest.index is not None:
        where = path / manifest.index.name
        found = read_index(where, tree.files)
        name = _unlike(wanted, found, set() if found.above is not None else BOXES_OF_BEFORE)
        if name is not None:
            raise FormatError(f"{where}: found another {name} than that of the files; build the scene again")
    return tree.num_leaves, len(tree)


def _check_pages(stored: StoredScene, index: StoreIndex) -> None:
    """Hold the rows of a file against the checksums of its own index, page by page, as a store does."""
    table = index.table
    for number, (begin, end) in enumerate(zip(table.begin.tolist(), table.end.tolist(), strict=True)):
        rows, checksums = stored.rows(begin, end), index.checksums_of(number)
        page_of(rows, str(stored.file.path), table.path(number), checksums=checksums).check_drawn(
            np.arange(end - begin, dtype=np.int32)
        )
        stored.forget(begin, end)


def _unlike(wanted: StoreIndex, found: StoreIndex, unlike: Collection[str] = ()) -> str | None:
    """The first field, but for some, in which an index is not the one that was made anew."""
    for struct, other in ((wanted, found), (wanted.table, found.table)):
        for name in (f.name for f in fields(struct) if f.name not in unlike):
            one, two = getattr(struct, name), getattr(other, name)
            if isinstance(one, np.ndarray | int) and not np.array_equal(one, two):
                return name
    return None
