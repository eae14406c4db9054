"""Build levels of detail over a scene that is larger than memory.

It goes in passes, each through files: a plan, slices of the input by cell, cells along the curve, the levels of each cell. Then
come levels of their roots in cells of their own, tier by tier, and the crown. Levels by a radius are those of `build_lod`, bit
for bit, however the scene was cut. Levels by pairs are chosen cell by cell, and what lies at borders of cells waits for the
levels above: docs/explanation/out-of-core.md.
"""

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError, OutputError
from splatree.io.formats.folder.manifest import MANIFEST, Manifest, is_manifest, total_bytes
from splatree.io.objects import ObjectPath, located
from splatree.io.options import ReadOptions
from splatree.kernels.cpu.build.visibility import NUM_AXES
from splatree.lod.options import BuildOptions
from splatree.outofcore.crown import Tier, finish_scene
from splatree.outofcore.cut import Cut, cut_into_cells, opened_inputs
from splatree.outofcore.options import PART_LEVELS, FolderOptions, Room, top_bytes
from splatree.outofcore.plan import Plan, plan_above
from splatree.outofcore.run import Workers, run_cells, run_pieces
from splatree.outofcore.shuffle import cell_sizes
from splatree.outofcore.sight import check_planes, write_seen
from splatree.outofcore.work import Work
from splatree.progress import task
from splatree.scene.names import Mode
from splatree.scene.scene import Source
from splatree.scene.trial import MethodTrial

__all__ = ["BuiltFolder", "check_target", "grow_folder"]


@dataclass(frozen=True)
class BuiltFolder:
    """A scene that was built through files.

    Example:
        >>> built = st.build_folder("city.ply", "parts.splatree")
        >>> built.num_gaussians, built.num_parts
        (253, 1)
    """

    path: Path
    """The folder."""
    num_gaussians: int
    """Leaves."""
    num_nodes: int
    """Leaves and merged nodes."""
    num_parts: int
    """Files of whole subtrees."""
    bytes: int
    """Size of all files."""
    rules: dict[str, Any]
    """Radii, and nodes left after each level, and the rules, as they are written into the folder."""
    repairs: dict[str, int] = field(default_factory=dict)
    """How many values or rows each rule of repair touched."""
    notes: tuple[str, ...] = ()
    """What reading and building did that the user should know, a sentence each."""
    trial: MethodTrial | None = None
    """How both methods did on a sample; None: the method was named, or the scene is too small to tell."""


def grow_folder(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: BuildOptions,
    running: FolderOptions,
    *,
    reading: ReadOptions,
    mode: Mode | None = None,
    executor: Executor | None = None,
    force: bool = False,
    trial: MethodTrial | None = None,
) -> BuiltFolder:
    """Build levels by a method that is named, and write a folder of parts: `build_folder` (render/folder.py) chooses the method.

    Raises:
        InputError: no method is named, or as `build_folder`; so are the other errors.
    """
    options = replace(options, method=options.named_method)
    path = located(output)
    target = check_target(path, force=force)
    work = Work.beside(target)
    with (
        opened_inputs(inputs, reading, mode) as opened,
        cut_into_cells(work, opened, options, options, running, reading=reading, executor=executor) as cut,
    ):
        manifest, report = _grown(work, cut, running, trial)
        _take_place(work, target, force)
    return BuiltFolder(
        path=path,
        num_gaussians=manifest.num_leaves,
        num_nodes=manifest.num_rows,
        num_parts=len(manifest.parts),
        bytes=total_bytes([manifest.crown, *manifest.parts]),
        rules=report,
        repairs=opened.repairs,
        notes=(
            *opened.notes,
            *cut.notes(running),
        ),
        trial=trial,
    )


def _grown(work: Work, cut: Cut, running: FolderOptions, trial: MethodTrial | None) -> tuple[Manifest, dict[str, Any]]:
    plan = cut.plan
    tiers = (_by_pairs if plan.resolved.method == "pairs" else _by_radius)(work, cut, running)
    return finish_scene(tiers, Source(metadata=plan.metadata, origin=plan.origin), trial)


def _by_radius(work: Work, cut: Cut, running: FolderOptions) -> list[Tier]:
    """Grow cells, and their roots in cells of their own, until what is left fits in memory; then all of it together."""
    _measure_sight(work, cut)
    tiers = [_grown_cells(work, cut.plan, cut.workers, running.part_levels or PART_LEVELS)]
    while not _fits(tiers[-1], cut.room):
        below = tiers[-1]
        if sum(below.roots) <= cut.plan.resolved.max_roots or not [*cut.plan.resolved.sizes_from(_num_sizes(below), 1)]:
            raise _too_many(sum(below.roots), cut.room)  # the tree ends here
        plan = plan_above(below.work, below.plan, below.roots, _num_sizes(below), whole=False)
        tiers.append(_grown_cells(below.work.above, plan, cut.workers, running.part_levels or PART_LEVELS))
    return [*tiers, _crown_above(tiers[-1], _num_sizes(tiers[-1]))]


def _grown_cells(work: Work, plan: Plan, workers: Workers, num_levels: int) -> Tier:
    """Grow cells by so many levels, or fewer where a build in memory ends before."""
    sizes = (
        cell_sizes(work, plan)
        if plan.first_roots is None
        else np.full(len(plan.cells), plan.num_rows / len(plan.cells))
    )
    while True:
        results = run_pieces(work, plan, "grow", workers, sizes.astype(float).tolist(), argument=num_levels)
        left = [sum(counts) for counts in zip(*(result["counts"] for result in results), strict=True)]
        ended = [level for level, num_left in enumerate(left[:-1]) if num_left <= plan.resolved.max_roots]
        if not ended:
            return Tier(work, plan, results)
        num_levels = ended[0]


def _num_sizes(tier: Tier) -> int:
    """Sizes of levels that the parts of a tier have gone through."""
    return tier.plan.num_sizes + len(tier.results[0]["counts"]) - 1


def _fits(tier: Tier, room: Room) -> bool:
    """Whether all roots of a tier can be grown together."""
    plan = tier.plan
    has_shown = plan.follows and plan.resolved.method == "pairs"
    return top_bytes(sum(tier.roots), (plan.sh_degree + 1) ** 2, follows=has_shown) <= room.max_bytes


def _crown_above(tier: Tier, num_sizes: int) -> Tier:
    """The last tier: all roots together, in this process."""
    plan = plan_above(tier.work, tier.plan, tier.roots, num_sizes, whole=True)
    above = tier.work.above
    return Tier(above, plan, run_pieces(above, plan, "crown", Workers(1), [float(plan.num_rows)]))


def _by_pairs(work: Work, cut: Cut, running: FolderOptions) -> list[Tier]:
    """Grow the cells to the same levels whatever the memory, for the tree depends on them."""
    plan = cut.plan
    _measure_sight(work, cut)
    tier = Tier(work, plan, run_cells(work, plan, "grow-pairs", cut.workers, argument=running.part_levels or 0))
    if not _fits(tier, cut.room):
        raise _too_many(sum(tier.roots), cut.room)
    return [tier, _crown_above(tier, 0)]


def _measure_sight(work: Work, cut: Cut) -> None:
    """Measure what is seen of each row, where the levels ask."""
    plan = cut.plan
    if plan.sight is not None:
        check_planes(plan, cut.room)
        run_pieces(work, plan, "sight", cut.workers, [float(plan.num_rows)] * NUM_AXES)
        write_seen(work, plan)


def _too_many(num_left: int, room: Room) -> InputError:
    return InputError(
        f"build: found {num_left} nodes that are left when all cells have grown, which do not fit in "
        f"{room.max_bytes // 10**6} MB at once; raise --max-memory"
    )


def check_target(output: str | os.PathLike[str], *, force: bool) -> Path:
    """Where the folder is to be.

    Raises:
        OutputError: it exists and is not to be replaced, or cannot be written there.
    """
    output = located(output)
    try:
        target = output.resolve()
        if not isinstance(target, ObjectPath) and not target.parent.is_dir():
            raise OutputError(f"{output}: cannot be written, there is no folder {target.parent}")
        if target.exists() and not force:
            raise OutputError(f"{output}: exists already; choose another name or replace it with force (--force)")
        if target.exists() and not (target.is_dir() and (is_manifest(target / MANIFEST) or not any(target.iterdir()))):
            raise OutputError(f"{output}: cannot be replaced, it is not the folder of a scene; choose another name")
    except RuntimeError as error:
        raise OutputError(f"{output}: cannot be written, its links lead in a circle") from error
    return target


def _take_place(work: Work, target: Path, force: bool) -> None:
    """Move the finished folder to its name, or send its files there, and remove the rest."""
    if isinstance(target, ObjectPath):
        _send(work.scene, target)
        work.clear()
        return
    old = work.folder / "old"
    if target.exists() and force:
        target.rename(old)
    work.scene.rename(target)  # from here on, another build begins anew
    work.clear()


def _send(folder: Path, target: ObjectPath) -> None:
    """Put the files of a folder into a store, the manifest last: until it is there, nothing is a scene."""
    manifest = target / MANIFEST
    manifest.unlink(missing_ok=True)  # of an older scene, whose parts are replaced now
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / MANIFEST)
    with task(f"send {target.name}", float(sum(path.stat().st_size for path in files))) as advance:
        for path in files:
            (target / path.relative_to(folder).as_posix()).put(path)
            advance(float(path.stat().st_size))
    manifest.put(folder / MANIFEST)
