"""The last pass: the levels above all parts, in memory, and the manifest."""

import json
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, StoredFile, read_manifest, stored_file
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.lod.assemble import with_report
from splatree.lod.forest import Forest, forest_of_roots
from splatree.lod.graft import graft
from splatree.lod.grow import grow
from splatree.outofcore.index import StoreIndex, index_of_folder
from splatree.outofcore.index_file import INDEX, write_index
from splatree.outofcore.pages import table_of
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, write_text
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.scene.trial import MethodTrial

__all__ = ["finish_scene", "replace_crown"]

CROWN = "crown.splatree"
"""Name of the file of the nodes above the parts."""


def finish_scene(
    work: Work,
    plan: Plan,
    results: Sequence[dict[str, Any]],
    source: Source,
    trial: MethodTrial | None = None,
    *,
    threads: int = 0,
) -> tuple[Manifest, dict[str, Any]]:
    """Grow the levels above the parts, write them and the manifest.

    Args:
        work: where the parts are.
        plan: what was decided for the whole scene.
        results: what came of each cell.
        source: provenance of the input.
        trial: how both methods did on a sample, for the record.
        threads: threads to use; 0: all.

    Returns:
        The manifest, and the report of the levels that was written with the scene.

    Raises:
        InputError: the parts do not hold every Gaussian once, or the tree is too deep.
    """
    files = [StoredFile(**result["file"]) for result in results if result["file"] is not None]
    for file in files:
        path = work.scene / file.name
        if not path.exists() or path.stat().st_size != file.num_bytes:
            raise InputError(
                f"{path}: found another file than was written, or none; delete {work.folder} and build again"
            )
    num_leaves = sum(result["leaves"] for result in results)
    if num_leaves != plan.num_rows:
        raise InputError(
            f"{work.folder}: found {num_leaves} leaves in all parts, wanted {plan.num_rows}; delete the folder and build again"
        )
    parts, first = [], 0
    for number, result in enumerate(results):
        if result["file"] is not None:
            roots = read(work.roots(number))
            ids = np.arange(first, first + len(roots), dtype=np.uint32)
            parts.append(replace(roots, ids=ids, source=Source()))
            first += len(roots)
    top = grow(forest_of_roots(parts, plan.resolved), plan.resolved, threads=threads)
    crown = graft(top, parts, plan.resolved, threads=threads)
    deepest = max(result["depth"] for result in results if result["file"] is not None)
    if crown.tree.num_levels + deepest > 256:
        raise InputError("build: found a node more than 255 levels below its root; raise growth")
    by_pairs = plan.resolved.method == "pairs"
    sizes, counts = (_levels_by_pairs if by_pairs else _levels)(plan, results, top)
    report_of_cells = {"cells": len(plan.cells)} if by_pairs and len(plan.cells) > 1 else {}
    source = with_report(source, plan.resolved, sizes, {"nodes": counts} | report_of_cells)
    num_copies = len(top.base.order)
    if plan.follows:
        crown = _with_drawn(
            crown, [read(work.drawn(i)) for i, result in enumerate(results) if result["file"] is not None]
        )
    assert crown.tree.record is not None
    tree = replace(crown.tree, record=replace(crown.tree.record, trial=trial))
    write(replace(crown, tree=tree, source=source, blocks=None), work.scene / CROWN, force=True)
    write_index(_index(work, files), work.scene / INDEX)
    manifest = Manifest(
        num_rows=sum(result["rows"] for result in results) + len(crown) - num_copies,
        num_leaves=num_leaves,
        crown=stored_file(work.scene, CROWN),
        parts=tuple(files),
        index=stored_file(work.scene, INDEX),
    )
    for path in (work.scene / "parts").iterdir():
        if path.name not in {Path(file.name).name for file in manifest.parts}:
            path.unlink()  # of fewer or more levels, which a first try was grown to
    write_text(work.scene / MANIFEST, manifest.to_json())
    report: dict[str, Any] = json.loads(source.metadata["levels"])
    return manifest, report


def _with_drawn(crown: Scene, roots: Sequence[Scene]) -> Scene:
    """The crown with copies of the roots of parts as they are drawn, and its own nodes as they are stored."""
    assert crown.ids is not None
    copies = np.flatnonzero(crown.tree.is_leaf)
    drawn = Gaussians.concatenate([part.gaussians for part in roots]).take(crown.ids[copies])
    columns = {f.name: getattr(crown.gaussians, f.name).copy() for f in fields(Gaussians)}
    for name, column in columns.items():
        column[copies] = getattr(drawn, name)
    curves = np.zeros((len(crown), 4), np.float32)
    curves[copies] = np.concatenate([part.tree.curves for part in roots])[crown.ids[copies]]
    return replace(crown, gaussians=Gaussians(**columns), tree=replace(crown.tree, curves=curves), blocks=None)


def replace_crown(folder: Path, crown: Scene) -> None:
    """Put another crown into a folder, of the same rows: what a scene says of how it is drawn stands there.

    The new crown is written beside the old one, and the manifest names it last: until then the folder is as it was.

    Raises:
        FormatError: the folder is damaged.
        OutputError: something could not be written.
    """
    manifest = read_manifest(folder)
    name = f"crown.{os.urandom(4).hex()}.splatree"
    write(crown, folder / name)
    try:
        write_text(folder / MANIFEST, replace(manifest, crown=stored_file(folder, name)).to_json())
    except BaseException:
        (folder / name).unlink(missing_ok=True)
        raise
    (folder / manifest.crown.name).unlink(missing_ok=True)


def _index(work: Work, files: Sequence[StoredFile]) -> StoreIndex:
    """What a selection by pages has to know of the parts."""
    crown = open_scene(work.scene / CROWN)
    parts = []
    with task("index pages", float(sum(file.num_bytes for file in files))) as advance:
        for file in files:
            parts.append(table_of(open_scene(work.scene / file.name), checksums=True))
            advance(float(file.num_bytes))
    return index_of_folder(crown, table_of(crown, checksums=True), parts, work.scene)


def _levels(plan: Plan, results: Sequence[dict[str, Any]], top: Forest) -> tuple[list[float], list[int]]:
    """Sizes of the levels that merged anything, and nodes left: at the beginning and after each."""
    left = np.sum([result["counts"] for result in results], axis=0).tolist()
    sizes = list(plan.resolved.sizes_from(0, len(left) - 1))
    merged = [i for i in range(len(sizes)) if left[i + 1] < left[i]]
    return [sizes[i] for i in merged] + list(top.sizes), [left[0], *(left[i + 1] for i in merged), *top.counts[1:]]


def _levels_by_pairs(plan: Plan, results: Sequence[dict[str, Any]], top: Forest) -> tuple[list[float], list[int]]:
    """The same for cells that have gone through different sizes, and for what waited at their borders."""
    merged = Counter[float]()
    for result in results:
        merged.update(dict(result.get("merged", ())))
    merged.update({size: before - left for size, (before, left) in zip(top.sizes, pairwise(top.counts), strict=True)})
    sizes = sorted(merged)
    return sizes, [plan.num_rows, *(plan.num_rows - np.cumsum([merged[size] for size in sizes])).tolist()]
