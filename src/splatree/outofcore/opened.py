"""Open a store: the files, what they say of themselves, and the index of their pages."""

import os
from pathlib import Path

from splatree.errors import FormatError, InputError
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, checked_path, folder_of, holds_parts, read_manifest
from splatree.io.formats.splatree.rows import StoredScene, open_scene
from splatree.io.memory import bytes_of, free_bytes
from splatree.io.objects import ObjectPath, at_once, located
from splatree.io.pages.index import StoreIndex, index_of_file, index_of_folder
from splatree.io.pages.index_file import read_index, read_own_index
from splatree.io.pages.table import table_of
from splatree.outofcore.store import Store
from splatree.progress import task
from splatree.scene.arguments import checked

__all__ = ["open_store"]


@checked
def open_store(path: str | os.PathLike[str], *, max_memory: str | None = None) -> Store:
    """Open a scene on disk, to select and draw from it without reading all of it.

    Args:
        path: a folder of parts, which `build_folder` made, or an exact ``.splatree``; or the address of either, of which only
            the ranges are fetched that are needed.
        max_memory: what the pages that are kept may take, such as 500M; None: half of the free memory.

    Returns:
        The store; use it in a ``with`` statement, or call `Store.close`.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: it cannot be read page by page.

    Example:
        >>> import splatree as st
        >>> with st.open_store("city.splatree", max_memory="500M") as store:
        ...     image = st.render(store, camera).image
    """
    path = folder_of(located(path))
    max_bytes = free_bytes() // 2 if max_memory is None else bytes_of(max_memory)
    if not holds_parts(path):
        if path.is_dir():
            raise InputError(
                f"{path}: found a folder without such a {MANIFEST}, wanted one that splatree build --max-memory made"
            )
        file = open_scene(path)
        index = read_own_index(file)
        if index is None:
            with task(f"index {path.name}", float(len(file))) as advance:
                index = index_of_file(table_of(file, advance=advance), len(file))
        return Store([file], index, max_bytes)
    manifest = read_manifest(path)
    files = [path / file.name for file in (manifest.crown, *manifest.parts)]
    crown, *parts = at_once(open_scene, files) if isinstance(path, ObjectPath) else map(open_scene, files)
    _check_alike(crown, parts)
    index = _index(path, manifest, crown, parts)
    if (index.num_rows, index.num_leaves) != (manifest.num_rows, manifest.num_leaves):
        raise FormatError(
            f"{path}: found {index.num_rows} rows and {index.num_leaves} leaves in the files, wanted {manifest.num_rows} and "
            f"{manifest.num_leaves} as the manifest says"
        )
    return Store([crown, *parts], index, max_bytes)


def _index(path: Path, manifest: Manifest, crown: StoredScene, parts: list[StoredScene]) -> StoreIndex:
    """The index that was written with the folder; made anew where there is none."""
    if manifest.index is not None:
        return read_index(checked_path(path, manifest.index), [crown, *parts])
    with task(f"index {path.name}", float(manifest.num_rows)) as advance:
        return index_of_folder(
            crown, table_of(crown, portals=True), (table_of(part, advance=advance) for part in parts), path
        )


def _check_alike(crown: StoredScene, parts: list[StoredScene]) -> None:
    wanted = _form_of(crown)
    for part in parts:
        if _form_of(part) != wanted:
            raise FormatError(
                f"{part.file.path}: found degree, mode and columns {_form_of(part)}, wanted {wanted} as in "
                f"{crown.file.path.name}; the file is of another build"
            )


def _form_of(stored: StoredScene) -> tuple[int, str, bool, bool]:
    head = stored.head
    return head.sh_degree, head.mode, head.has_ids, head.has_curves
