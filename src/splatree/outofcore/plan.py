"""The first pass: what has to be decided for the whole scene before it is cut.

All rows are read once. Their means, 12 bytes a row, stay in a file. What else is needed of the whole scene is taken from there,
by the functions that a build in memory calls: the grid of the Morton codes, the automatic radius, a sample for the cells.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.chunks import Chunks
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.options import ReadOptions
from splatree.kernels.cpu.build.thin import nearest_distances
from splatree.kernels.cpu.build.visibility import Sight
from splatree.lod.cells import Cells, halve
from splatree.lod.options import BuildOptions
from splatree.lod.resolve import Measures, ResolvedBuild, first_pixel, follows_pixels, merge_rules, resolve
from splatree.maths.morton import morton_frame
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.options import FolderOptions, Room, rows_above
from splatree.outofcore.work import Work, write_text
from splatree.progress import task
from splatree.scene.names import Mode
from splatree.scene.origin import Origin
from splatree.scene.thinning import ThinOptions
from splatree.shapes import Array
from splatree.simplify.merge import check_finite, largest_log_weight
from splatree.simplify.thin import query_rows, radius_of_spacing
from splatree.simplify.visibility import NUM_SAMPLES, SIZE_SAMPLES, median_size, sample_of, sight_of

__all__ = ["Plan", "make_plan", "plan_above", "read_plan"]

SAMPLE_ROWS = 1 << 20
"""Rows of which the cells are made."""

BATCH_ROWS = 1 << 20
"""Rows among which nearest neighbours are looked for at a time."""


@dataclass(frozen=True)
class Plan:
    """What every piece of work has to know."""

    run: str
    """Names the run: marks of other runs do not count."""
    request: Mapping[str, Any]
    """What was asked for, and of which files: a build goes on where it stopped only if this is the same."""
    fingerprint: str
    """What this program computes of fixed numbers: other programs may not take part."""
    num_rows: int
    """Gaussians of the input."""
    sh_degree: int
    """Degree of their harmonics."""
    mode: Mode
    """How the scene is drawn."""
    metadata: Mapping[str, str]
    """Provenance of the input."""
    origin: Origin
    """Where the zero of the scene lies in the world."""
    resolved: ResolvedBuild
    """What was decided for the whole scene."""
    cells: Cells
    """Where the scene is cut."""
    slice_rows: int
    """Rows of the input in a slice."""
    part_rows: int
    """Rows of a cell."""
    widest: float
    """The longest side of the box around all means, world units."""
    sight: Sight | None
    """Levels by pairs, and levels that follow: the lengths by which the scene is looked at; None: nothing hides anything."""
    follows: bool
    """Whether merged Gaussians follow the pixel that they are drawn at."""
    first_roots: tuple[int, ...] | None = None
    """Above parts, how many roots the parts before each one have together; None: what grows are the Gaussians of the input."""
    num_sizes: int = 0
    """Sizes of levels that the parts below have gone through."""

    @property
    def num_files(self) -> int:
        """Files of rows that grow: one for each cell, or above parts one for each part."""
        return len(self.cells) if self.first_roots is None else len(self.first_roots)

    @property
    def num_slices(self) -> int:
        """Slices of the input."""
        return -(-self.num_rows // self.slice_rows)

    def to_json(self) -> str:
        """The plan as a JSON object."""
        kept = {name: value for name, value in vars(self).items() if name not in ("resolved", "cells", "sight")}
        sight = self.sight and {**vars(self.sight), "middle": self.sight.middle.tolist()}
        return json.dumps({**kept, "resolved": self.resolved.to_json(), "cells": self.cells.halvings, "sight": sight})

    @staticmethod
    def from_json(text: str) -> "Plan":
        """What `to_json` wrote."""
        fields = json.loads(text)
        fields["resolved"] = ResolvedBuild.from_json(fields["resolved"])
        fields["cells"] = Cells.of_halvings(fields["cells"])
        if (sight := fields["sight"]) is not None:
            fields["sight"] = Sight(**{**sight, "middle": np.array(sight["middle"])})
        if (first_roots := fields["first_roots"]) is not None:
            fields["first_roots"] = tuple(first_roots)
        x, y, z = fields["origin"]
        return Plan(**{**fields, "origin": (x, y, z)})


def read_plan(work: Work) -> Plan:
    """The plan of a build that has begun.

    Raises:
        InputError: the file cannot be used.
    """
    try:
        return Plan.from_json(work.plan.read_text("utf-8"))
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise InputError(f"{work.plan}: cannot be used ({error}); delete {work.folder} and build again") from error


def make_plan(
    work: Work, chunks: Chunks, options: BuildOptions, request: Mapping[str, Any], room: Room, *, threads: int = 0
) -> Plan:
    """Read all rows once, decide, and write the plan.

    Raises:
        InputError: there is no Gaussian, there are too many to be numbered, or one cannot be merged.
    """
    n = len(chunks)
    if not 0 < n < 2**32:
        raise InputError(f"input: found {n} Gaussians, wanted 1 to 2^32 - 1 for a build in parts")
    means_path = work.folder / "means.bin"
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    largest_log_scale = largest_weight = -np.inf
    sizes, num_read, stride = [], 0, n // SIZE_SAMPLES + 1  # of the rows that `sample_of` takes
    weight = merge_rules(options, chunks.mode).weight or "opacity"
    with means_path.open("wb") as file, task("read means", float(n)) as advance:
        for chunk in chunks:
            check_finite(chunk)
            file.write(np.ascontiguousarray(chunk.means).data)
            if len(chunk):
                low, high = np.minimum(low, chunk.means.min(axis=0)), np.maximum(high, chunk.means.max(axis=0))
                largest_log_scale = max(largest_log_scale, float(chunk.log_scales.max()))
                largest_weight = max(largest_weight, largest_log_weight(chunk, weight))
                sizes.append(chunk.log_scales[-num_read % stride :: stride].copy())
                num_read += len(chunk)
            advance(float(len(chunk)))
    means = np.memmap(means_path, np.float32, "r", shape=(n, 3))
    size = median_size(np.concatenate(sizes))
    by_pairs = options.named_method == "pairs"
    measures = Measures(
        first_size=options.pixel_size or first_pixel(size)
        if by_pairs
        else _first_radius(means, options, float(np.max(high - low)), threads),
        low=(float(low[0]), float(low[1]), float(low[2])),
        high=(float(high[0]), float(high[1]), float(high[2])),
        largest_log_scale=largest_log_scale,
        largest_log_weight=largest_weight,
        frame=morton_frame(means),
    )
    sample = np.array(means[:: n // SAMPLE_ROWS + 1])
    resolved = resolve(options, measures, chunks.mode)
    sight = sight_of(sample_of(means, NUM_SAMPLES), n, size) if resolved.visibility else None
    cells = halve(sample, room.part_rows * len(sample) / n)
    del means, sample
    means_path.unlink()
    row_bytes = 60 + 12 * (chunks.sh_degree + 1) ** 2
    run = hashlib.blake2b(json.dumps([request, room.part_rows, fingerprint()]).encode(), digest_size=8).hexdigest()
    plan = Plan(
        run=run,
        request=request,
        fingerprint=fingerprint(),
        num_rows=n,
        sh_degree=chunks.sh_degree,
        mode=chunks.mode,
        metadata=dict(chunks.metadata),
        origin=chunks.origin,
        resolved=resolved,
        cells=cells,
        slice_rows=max(1000, min(room.part_rows, room.max_bytes // 8 // row_bytes)),
        part_rows=room.part_rows,
        widest=float(np.max(high - low)),
        sight=sight,
        follows=follows_pixels(options, chunks.mode),
    )
    write_text(work.plan, plan.to_json())
    return plan


def plan_above(work: Work, plan: Plan, roots: Sequence[int], num_sizes: int, *, whole: bool) -> Plan:
    """Cut the roots of parts into cells of their own, and write the plan of the levels above.

    Args:
        work: where the parts are.
        plan: theirs.
        roots: how many each part has.
        num_sizes: sizes of levels that the parts have gone through.
        whole: put all roots into one cell.
    """
    above, first = work.above, np.cumsum([0, *roots]).tolist()
    step, files = first[-1] // SAMPLE_ROWS + 1, [number for number, count in enumerate(roots) if count]
    sample = np.concatenate([open_scene(above.cell(file)).file.rows("gaussians.means")[::step] for file in files])
    cells = Cells.of_halvings(()) if whole else halve(sample, rows_above(plan.part_rows) * len(sample) / first[-1])
    found = replace(plan, num_rows=first[-1], cells=cells, first_roots=tuple(first[:-1]), num_sizes=num_sizes)
    found = replace(found, run=hashlib.blake2b(found.to_json().encode(), digest_size=8).hexdigest())
    above.begin()
    write_text(above.plan, found.to_json())
    return found


def _first_radius(means: Array, options: BuildOptions, widest: float, threads: int) -> float:
    """The radius of the first level: `auto_radius` of rows that are not all in memory."""
    if not isinstance(options.radius, str):
        return float(options.radius)
    n = len(means)
    if n < 2:
        return 0.0
    queries = query_rows(n)
    sample = np.array(means[queries])

    def nearest(edge: float) -> Array:
        distances = np.full(len(queries), np.inf)
        for others in _batches(means, queries):
            points = np.concatenate([sample, others])
            found = nearest_distances(points, np.arange(len(queries), dtype=np.int32), edge=edge, threads=threads)
            np.minimum(distances, found, out=distances)
        return distances

    return radius_of_spacing(sample, n, widest, nearest)


def _batches(means: Array, queries: Array) -> Iterator[Array]:
    """All rows but the queries, a batch at a time."""
    for begin in range(0, len(means), BATCH_ROWS):
        rows = np.arange(begin, min(begin + BATCH_ROWS, len(means)))
        yield means[rows[~np.isin(rows, queries)]]


def request_of(
    inputs: list[dict[str, Any]],
    options: BuildOptions | ThinOptions,
    running: FolderOptions,
    reading: ReadOptions,
    mode: Mode,
) -> dict[str, Any]:
    """What was asked for, as it is compared when a build goes on."""
    request = {
        "inputs": inputs,
        "verb": type(options).__name__,
        "options": asdict(options),
        "reading": asdict(reading),
        "mode": mode,
        "part_rows": running.part_rows,
        "part_levels": running.part_levels,
    }
    kept: dict[str, Any] = json.loads(json.dumps(request))  # as it comes back from a file
    return kept
