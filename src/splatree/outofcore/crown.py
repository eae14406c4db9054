"""The crown, what it takes to draw from the folder, and the manifest.

Parts are grown in tiers. Each tier grows the roots of the one below to parts, in cells of its own, and the last one has a single
part. So a tier and all above it are a folder of parts: the tree above is its crown. It is gone through as a whole, in runs of
rows, and written as the crown of the tier below, down to the parts that hold the leaves.
"""

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.chunks import ROWS_PER_CHUNK
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, StoredFile, read_manifest, stored_file
from splatree.io.formats.folder.whole import open_whole
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows, StoredScene, open_scene
from splatree.io.formats.splatree.writer import create_scene, write_plain
from splatree.io.pages.index import StoreIndex, index_of_folder
from splatree.io.pages.index_file import INDEX, write_index
from splatree.io.pages.table import FilePages, table_of
from splatree.lod.assemble import record_of, with_report
from splatree.outofcore.follow import with_followed_nodes
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, write_text
from splatree.progress import task
from splatree.scene.scene import Scene, Source
from splatree.scene.trial import MethodTrial

__all__ = ["Tier", "finish_scene", "replace_crown"]

CROWN = "crown.splatree"
"""Name of the file of the nodes above the parts."""


@dataclass(frozen=True)
class Tier:
    """Cells that were grown through the same sizes, each to a part."""

    work: Work
    """Where the parts are."""
    plan: Plan
    """What was decided for the tier."""
    results: Sequence[dict[str, Any]]
    """What came of each cell."""

    @property
    def files(self) -> tuple[StoredFile, ...]:
        """The parts."""
        return tuple(StoredFile(**result["file"]) for result in self.results if result["file"] is not None)

    @property
    def roots(self) -> list[int]:
        """How many roots the part of each cell has."""
        return [result["roots"] for result in self.results]

    def manifest(self, above: SceneHead, index: StoredFile | None = None) -> Manifest:
        """That of the folder of the parts, whose crown is ``above``."""
        num_rows = sum(result["rows"] for result in self.results) + above.num_rows - sum(self.roots)
        return Manifest(num_rows, self.plan.num_rows, stored_file(self.work.scene, CROWN), self.files, index)

    def check(self) -> None:
        """Refuse parts that are not all there.

        Raises:
            InputError: they are not.
        """
        folder = self.work.folder
        for file in self.files:
            path = self.work.scene / file.name
            if not path.exists() or path.stat().st_size != file.num_bytes:
                raise InputError(
                    f"{path}: found another file than was written, or none; delete {folder} and build again"
                )
        num_leaves = sum(result["leaves"] for result in self.results)
        if num_leaves != self.plan.num_rows:
            raise InputError(
                f"{folder}: found {num_leaves} leaves in all parts, wanted {self.plan.num_rows}; delete the folder and build "
                "again"
            )


def finish_scene(
    tiers: Sequence[Tier], source: Source, trial: MethodTrial | None = None
) -> tuple[Manifest, dict[str, Any]]:
    """Write the crown of the first tier, the index of its folder, and the manifest.

    Args:
        tiers: the parts with the leaves first; the last tier has one part.
        source: provenance of the input.
        trial: how both methods did on a sample, for the record.

    Returns:
        The manifest, and the report of the levels that was written with the scene.

    Raises:
        InputError: the parts do not hold every Gaussian once, or the tree is too deep.
    """
    for tier in tiers:
        tier.check()
    if sum(max(result["depth"] for result in tier.results) for tier in tiers) > 255:
        raise InputError("build: found a node more than 255 levels below its root; raise growth")
    first, plan, folder = tiers[0], tiers[0].plan, tiers[0].work.scene
    sizes, counts = _levels(tiers)
    is_cut = plan.resolved.method == "pairs" and len(plan.cells) > 1
    source = with_report(
        source, plan.resolved, sizes, {"nodes": counts} | ({"cells": len(plan.cells)} if is_cut else {})
    )
    head, rows = _whole(tiers[1:])
    head = replace(head, record=replace(record_of(plan.resolved, sizes), trial=trial), source=source)
    if plan.follows and plan.resolved.method == "radius":
        crown = _stored(tiers[1:], first.work.folder / CROWN, head, rows)
        head, rows = replace(head, has_curves=True), with_followed_nodes(first.work, plan, first.roots, crown)
    _write_crown(folder / CROWN, head, rows)
    write_index(_index(folder, first.files), folder / INDEX)
    manifest = first.manifest(head, stored_file(folder, INDEX))
    for path in (folder / "parts").iterdir():
        if path.name not in {Path(file.name).name for file in manifest.parts}:
            path.unlink()  # of more levels, which a first try was grown to
    write_text(folder / MANIFEST, manifest.to_json())
    report: dict[str, Any] = json.loads(source.metadata["levels"])
    return manifest, report


def _whole(tiers: Sequence[Tier]) -> tuple[SceneHead, Iterator[SceneRows]]:
    """The tree of a tier and all above it, in runs of rows."""
    tier, *above = tiers
    folder = tier.work.scene
    if not above:
        stored = _only_part(tier)
        return stored.head, _runs(stored)
    head, rows = _whole(above)
    _write_crown(folder / CROWN, head, rows)
    write_text(folder / MANIFEST, tier.manifest(head).to_json())
    tree = open_whole(folder, checked=False)
    return tree.head, tree.runs("put levels together")


def _stored(tiers: Sequence[Tier], path: Path, head: SceneHead, rows: Iterator[SceneRows]) -> StoredScene:
    """A file of the rows of `_whole`: that of the only part, or a new one."""
    if len(tiers) == 1:
        return _only_part(tiers[0])
    _write_crown(path, head, rows)
    return open_scene(path)


def _only_part(tier: Tier) -> StoredScene:
    (file,) = tier.files
    return open_scene(tier.work.scene / file.name)


def _runs(stored: StoredScene) -> Iterator[SceneRows]:
    for begin in range(0, len(stored), ROWS_PER_CHUNK):
        yield stored.rows(begin, min(begin + ROWS_PER_CHUNK, len(stored)))


def _write_crown(path: Path, head: SceneHead, rows: Iterator[SceneRows]) -> None:
    with create_scene(path, head, force=True, pages=False) as writer:
        for run in rows:
            writer.append(run)


def replace_crown(folder: Path, crown: Scene) -> None:
    """Put another crown into a folder, of the same rows: what a scene says of how it is drawn stands there.

    The new crown is written beside the old one, and the manifest names it last: until then the folder is as it was.

    Raises:
        FormatError: the folder is damaged.
        OutputError: something could not be written.
    """
    manifest = read_manifest(folder)
    name = f"crown.{os.urandom(4).hex()}.splatree"
    write_plain(crown, folder / name)
    try:
        write_text(folder / MANIFEST, replace(manifest, crown=stored_file(folder, name)).to_json())
    except BaseException:
        (folder / name).unlink(missing_ok=True)
        raise
    (folder / manifest.crown.name).unlink(missing_ok=True)


def _index(folder: Path, files: Sequence[StoredFile]) -> StoreIndex:
    """What a selection by pages has to know of the parts."""
    crown = open_scene(folder / CROWN)
    with task("index pages", float(sum(file.num_bytes for file in files))) as advance:

        def pages() -> Iterator[FilePages]:
            for file in files:
                yield table_of(open_scene(folder / file.name), checksums=True)
                advance(float(file.num_bytes))

        return index_of_folder(crown, table_of(crown, portals=True, checksums=True), pages(), folder)


def _levels(tiers: Sequence[Tier]) -> tuple[list[float], list[int]]:
    """Sizes of the levels that merged anything, and nodes left: at the beginning and after each.

    Cells by pairs have gone through different sizes. By a radius, merged nodes may lie in another cell than what they were merged
    of, so only the sum over all cells says whether a level merged anything.
    """
    merged = Counter[float]()
    for tier in tiers:
        for result in tier.results:
            merged.update(dict(result.get("merged", ())))
    sizes = sorted(size for size, count in merged.items() if count)
    n = tiers[0].plan.num_rows
    return sizes, [n, *(n - np.cumsum([merged[size] for size in sizes])).tolist()]
