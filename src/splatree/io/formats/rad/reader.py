"""``.rad`` (Spark): a tree of Gaussians in compressed chunks of 65,536, the coarsest first, made to be streamed.

``RAD0``, the length of a JSON header, the header, padding to 8 bytes; then the chunks, each ``RADC``, the length of its JSON
header, the header, padding, the bytes of its payload (u8) and the payload: properties, each padded to 8 bytes, mostly deflated.
The header lists the chunks' places and sizes (`rad_container`); a chunk's header its properties', with encoding and range
(`rad_properties`). Written by `rad_writer`. Layout and deviations: docs/reference/formats/rad.md.

The children of a node follow each other: ``child_start``, ``child_count``; node 0 is the root. Several roots get a node above
them, their moment merge, which a key of our own marks so that reading takes it away again.

In a file with levels, an opacity a above 1 stands for D = 4 a − 3 and an exponent A = e^((D² − 1)/e); see
`splatree.io.opacities`.

Reading goes over the file twice: the links say where each row belongs, so that the other properties are decoded, chunk by chunk
and those of a chunk on all processors, into their places.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SH_C0
from splatree.errors import FormatError
from splatree.io.check import checked
from splatree.io.chunks import Chunks
from splatree.io.formats.rad.container import MAGIC, RadChunk, RadFile, open_rad, values_of
from splatree.io.levels import FileLevels, preorder_of_file, scene_with_levels
from splatree.io.opacities import CODE_STEP, areas_of_powers, logits_from_opacities
from splatree.io.options import ReadOptions
from splatree.io.rows import FileRows, Fill, columns_to_fill
from splatree.kernels.cpu import _core
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import UNKNOWN_LEVELS
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.scene import Scene
from splatree.shapes import Array

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

_OPAQUE_MAX = 5.0
"""Largest D."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins as the format does."""
    return head[:4] == MAGIC


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all chunks, those in files beside it too; a tree keeps its levels."""
    from concurrent.futures import ThreadPoolExecutor

    file = open_rad(path)
    n = file.count
    gaussians = columns_to_fill(n, file.degree)
    with task(f"read {path.name}", n) as advance, ThreadPoolExecutor(_core.hardware_threads()) as pool:
        subtree_end, depth, row_from_node = _tree(file)
        palette = _palette(file) if n else None
        num_opaque = 0
        for chunk in file.chunks:
            nodes = slice(chunk.base, chunk.base + chunk.count)
            rows = row_from_node[nodes] if file.has_levels else nodes
            num_opaque += _fill(file, gaussians, palette, rows, chunk, pool)
            advance(chunk.count)
    if file.joins_roots:
        gaussians = Gaussians(
            *(getattr(gaussians, c)[1:] for c in ("means", "quats", "log_scales", "logit_opacities", "sh"))
        )
        subtree_end, depth = subtree_end[1:] - 1, depth[1:] - np.uint8(1)
    levels = FileLevels(subtree_end, depth, file.record or UNKNOWN_LEVELS, _extents(file, row_from_node))
    scene = scene_with_levels(
        gaussians, levels, str(path), repair=options.repair, num_opaque=num_opaque, mode=file.mode
    )
    metadata = dict(scene.source.metadata)
    if file.comment:
        metadata["comment"] = file.comment
    return replace(scene, threshold=file.threshold, source=replace(scene.source, metadata=metadata))


def read_first_chunk(path: Path) -> Scene:
    """The first chunk alone, without levels: of a file with a tree the nodes of the chunk whose children begin beyond it."""
    from concurrent.futures import ThreadPoolExecutor

    file = open_rad(path)
    if not file.chunks:
        return Scene.flat(Gaussians.empty(file.degree), mode=file.mode)
    chunk = file.chunks[0]
    gaussians = columns_to_fill(chunk.count, file.degree)
    with ThreadPoolExecutor(_core.hardware_threads()) as pool:
        _fill(file, gaussians, _palette(file), slice(0, chunk.count), chunk, pool)
    if file.has_levels:
        starts, counts = (values_of(chunk, name)[:, 0] for name in ("child_start", "child_count"))
        gaussians = gaussians.take(np.flatnonzero((counts == 0) | (starts >= chunk.count)))
    return checked(Scene.flat(gaussians, mode=file.mode), str(path), repair=False)


def read_chunks(path: Path, options: ReadOptions) -> Chunks | None:
    """The same values in chunks; None for a file with levels, opacities above 1 or a τ of its own, which is read as a whole."""
    file = open_rad(path)
    if file.has_levels or file.has_lod_opacities or file.threshold != ALPHA_THRESHOLD:
        return None
    ends = np.cumsum([chunk.count for chunk in file.chunks], dtype=np.int64)

    @contextmanager
    def start() -> Iterator[Fill]:
        from concurrent.futures import ThreadPoolExecutor

        palette = _palette(file) if file.count else None
        decoded, number = columns_to_fill(0, file.degree), -1

        with ThreadPoolExecutor(_core.hardware_threads()) as pool:

            def fill(begin: int, out: Gaussians) -> None:
                nonlocal decoded, number
                done = 0
                while done < len(out):
                    wanted = int(np.searchsorted(ends, begin + done, side="right"))
                    chunk = file.chunks[wanted]
                    if wanted != number:
                        if len(decoded) < chunk.count:
                            decoded = columns_to_fill(chunk.count, file.degree)
                        _fill(file, decoded, palette, slice(0, chunk.count), chunk, pool)
                        number = wanted
                    first = begin + done - chunk.base
                    count = min(len(out) - done, chunk.count - first)
                    for column in fields(out):
                        rows = getattr(decoded, column.name)[first : first + count]
                        getattr(out, column.name)[done : done + count] = rows
                    done += count

            yield fill

    metadata = {"comment": file.comment} if file.comment else {}
    return FileRows(str(path), file.count, file.degree, start, file.mode, metadata).chunks(options)


def _tree(file: RadFile) -> tuple[Array, Array, Array]:
    """Subtree end and depth of each row, and the row of each node."""
    n = file.count
    if not file.has_levels or n == 0:
        return np.arange(1, n + 1, dtype=np.int32), np.zeros(n, np.uint8), np.arange(n, dtype=np.int32)
    links = np.empty((2, n), np.int64)
    for chunk in file.chunks:
        for link, name in zip(links, ("child_start", "child_count"), strict=True):
            if name not in chunk.properties:
                raise FormatError(f"{chunk.where}: found no {name}, wanted it in a file with a tree")
            link[chunk.base : chunk.base + chunk.count] = values_of(chunk, name)[:, 0]
    order = preorder_of_file(links[0], links[1], np.zeros(1, np.int32), file.where)
    row_from_node = np.empty(n, np.int32)
    row_from_node[order.node_from_row] = np.arange(n, dtype=np.int32)
    return order.subtree_end, order.depth, row_from_node


def _extents(file: RadFile, row_from_node: Array) -> Array | None:
    """Extents of the inner rows, 0 for leaves; None if they are balls around what is below."""
    if file.record is None or file.record.profile not in EXTENT_PROFILES:
        return None
    extents = np.zeros(file.count, np.float32)
    for chunk in file.chunks:
        if "extent" not in chunk.properties:
            raise FormatError(f"{chunk.where}: found no extent, wanted it for levels of the rule {file.record.rule}")
        is_inner = values_of(chunk, "child_count")[:, 0] > 0
        rows = row_from_node[chunk.base : chunk.base + chunk.count][is_inner]
        extents[rows] = values_of(chunk, "extent", len(rows))[:, 0]
    return extents[1:] if file.joins_roots else extents


def _palette(file: RadFile) -> Array | None:
    """Harmonics beyond the DC of each label "p 3K"; None if the file has no palette. The first chunk holds it."""
    first = file.chunks[0]
    if file.degree == 0 or "sh1_code" not in first.properties:
        return None
    names = [f"sh{order}_code" for order in range(1, file.degree + 1)]
    missing = [name for name in names if name not in first.properties]
    if missing or file.num_codes == 0:
        raise FormatError(
            f"{first.where}: found no {(missing or ['shCodeCount'])[0]}, wanted a palette of degree {file.degree}"
        )
    return np.concatenate([values_of(first, name, file.num_codes) for name in names], axis=1)


def _fill(
    file: RadFile,
    g: Gaussians,
    palette: Array | None,
    rows: Array | slice,
    chunk: RadChunk,
    pool: "ThreadPoolExecutor",
) -> int:
    """Decode a chunk into these rows, its properties on all processors; return how many of its opacities were above 1."""
    harmonics = [f"sh{order}" for order in range(1, file.degree + 1)] if palette is None else ["sh_label"]
    names = ["center", "alpha", "rgb", "scales", "orientation", *harmonics]
    missing = [name for name in names if name not in chunk.properties]
    if missing:
        why = {"sh_label": "for the palette of the first chunk"}.get(missing[0], "in every chunk")
        raise FormatError(f"{chunk.where}: found no {missing[0]}, wanted it {why}")
    values = dict(zip(names, pool.map(partial(values_of, chunk), names), strict=True))
    g.means[rows] = values["center"]
    g.quats[rows] = values["orientation"]
    g.sh[rows, 0] = (values["rgb"] - np.float32(0.5)) / np.float32(SH_C0)
    log_scales, alphas = values["scales"], values["alpha"][:, 0]
    num_opaque = 0
    if file.has_lod_opacities:
        above = np.flatnonzero(alphas > 1)
        num_opaque = len(above)
        d = np.minimum(4 * alphas[above].astype(np.float64) - 3, _OPAQUE_MAX)
        log_scales[above] += 0.5 * np.log(areas_of_powers(np.exp((d * d - 1) / math.e)))[:, None]
    g.log_scales[rows] = log_scales
    steps = {"f32": (2.0**-148, 2.0**-24), "f16": (2.0**-24, 2.0**-11)}
    step_low, step_high = steps.get(chunk.properties["alpha"]["encoding"], (CODE_STEP, CODE_STEP))
    g.logit_opacities[rows] = logits_from_opacities(alphas, step_low=step_low, step_high=step_high)

    rest = g.sh.reshape(len(g), -1)
    if palette is not None:
        labels = values["sh_label"][:, 0]
        if len(labels) and int(labels.max()) >= len(palette):
            raise FormatError(
                f"{chunk.where}: sh_label: found {labels.max()}, wanted less than the {len(palette)} entries"
            )
        rest[rows, 3:] = palette[labels]
        return num_opaque
    for order in range(1, file.degree + 1):
        rest[rows, 3 * order * order : 3 * (order + 1) ** 2] = values[f"sh{order}"]
    return num_opaque
