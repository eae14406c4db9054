"""Scenes that are drawn where they lie and not read as a whole: a folder of parts, a .splatree with --max-memory, or one that is
larger than half of the free memory."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from splatree.cli.console import UsageError
from splatree.cli.files import Reading, read_scene
from splatree.io.formats.splatree.format import is_compact
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.inputs import check_are_there
from splatree.io.local import is_brought, place_of
from splatree.io.memory import free_bytes
from splatree.io.registry import detect, stored_bytes
from splatree.lod.baselines import Baseline
from splatree.outofcore.opened import open_store
from splatree.outofcore.store import Store
from splatree.render.timing import peak_bytes
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

__all__ = ["bytes_of", "counts_of", "needs_all_rows", "opened", "sample_of"]


@contextmanager
def opened(
    paths: Sequence[Path], reading: Reading, max_memory: str | None, *, whole: Sequence[str] = ()
) -> Iterator[Scene | Store]:
    """The scene of all paths, read; or a store, where one path is a folder of parts or a large file, or ``max_memory`` is given.

    ``whole`` names options that are given and need all rows: then a folder is read.

    Raises:
        UsageError: ``max_memory`` is given, and the paths cannot be read page by page, or all rows are needed.
    """
    paths = [place_of(path) for path in paths]
    by_ranges = max_memory is not None and paths[0].suffix == ".splatree"  # an address is not brought here then
    found = detect(paths[0]) if len(paths) == 1 and (by_ranges or not is_brought(paths[0])) else None
    name = None if found is None else found.name
    is_folder = name == "splatree-folder"
    if max_memory is not None and (whole or not (is_folder or name == "splatree")):
        if whole:
            raise UsageError(
                f"max_memory: found {_named(whole)}, which needs all rows in memory; leave out one of both"
            )
        check_are_there(paths)
        raise UsageError(
            f"max_memory: found {', '.join(map(str, paths))}, wanted one .splatree or one folder of parts; splatree build makes "
            "either"
        )
    if whole and is_folder and (needed := stored_bytes(paths[0])) > (free := free_bytes()):
        raise UsageError(
            f"{_named(whole)}: needs all rows of {paths[0]} in memory, {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free; "
            "without it only the pages are read that views need"
        )
    by_pages = is_folder or max_memory is not None or (name == "splatree" and _is_large(paths[0], reading))
    if whole or not by_pages:
        yield read_scene(paths, reading)
        return
    with open_store(paths[0], max_memory=max_memory) as store:
        yield store


def _is_large(path: Path, reading: Reading) -> bool:
    """Whether a file with levels would take more than half of the free memory, and can be drawn page by page."""
    if reading != Reading() or 2 * stored_bytes(path) <= free_bytes() or is_compact(path):
        return False
    return open_scene(path).head.record is not None


def _named(options: Sequence[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in options)


def needs_all_rows(select: SelectOptions) -> list[str]:
    """The options of a selection that cannot be made page by page."""
    needed = {
        "rule": select.rule != "cut",
        "cull": select.cull not in (None, "none"),
    }
    return [name for name, is_needed in needed.items() if is_needed]


def sample_of(scene: Scene | Store) -> Scene:
    """What says where a scene lies: the scene, or a sample of a store."""
    return scene.sample() if isinstance(scene, Store) else scene


def counts_of(scene: Scene | Store) -> dict[str, int]:
    """Gaussians, nodes and levels."""
    if isinstance(scene, Store):
        index = scene.index
        return {"num_gaussians": index.num_leaves, "num_nodes": index.num_rows, "levels": index.num_levels}
    return {"num_gaussians": scene.tree.num_leaves, "num_nodes": len(scene), "levels": scene.tree.num_levels}


def bytes_of(scene: Scene | Store, select: SelectOptions | Baseline) -> dict[str, int | None]:
    """Memory of the scene; of a store, that of its pages, which are Gaussians and tree together."""
    if isinstance(scene, Store):
        return {"pages": scene.resident_bytes, "selection": scene.index.nbytes, "peak": peak_bytes()}
    tree, blocks = scene.tree, 0 if scene.blocks is None else scene.blocks.nbytes
    return {
        "gaussians": scene.gaussians.nbytes,
        "tree": tree.subtree_end.nbytes + tree.depth.nbytes + tree.extents.nbytes,
        "selection": select.num_bytes if isinstance(select, Baseline) else blocks,
        "peak": peak_bytes(),
    }
