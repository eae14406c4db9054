"""The levels that PlayCanvas 2.23 chooses of a streamed SOG: bands of distance, moved until a budget of Gaussians is met.

The distance of a chunk is that of its box from the eye. Of a box whose half side is longer than the median half side of all
boxes, three quarters of what is longer are taken off first. A chunk behind the eye counts as up to 1.5 times as far. The
distance is then scaled by tan(fov / 2) of the smaller field of view against that of 45°. The level is one of bands that each
are three times as deep as the one before; all bands move together, to the finest place where the sum of all chunks fits the
budget. A chunk without the level takes its next finer one, or its coarsest if it has none that coarse.

PlayCanvas 2.22 can choose by tables of errors instead (`select_by_errors`). All chunks begin at their coarsest level. A step to a
finer level is worth c Δerror / Δcount, the best of the ways on to a finer one; c = (r / (r + distance))² for a chunk of radius r.
Steps are taken from the most worth down until one does not fit the budget. The engine sorts worths into classes, here they are
exact. Levels that have more rows than another one and no smaller error are left out.
"""

import heapq

import numpy as np

from splatree.scene.cameras import Camera
from splatree.shapes import Array, Float64, Int64
from splatree.stream.readers.sog_stream import Ranges

__all__ = ["select_by_errors", "select_playcanvas"]

_SHRINK, _BEHIND, _BAND = 0.75, 1.5, 3.0
_HALVINGS = 40


def select_playcanvas(ranges: Ranges, camera: Camera, budget: int, *, band: float = _BAND) -> Int64[Array, "c"]:
    """The level of each chunk; the coarsest of all where even that is more than ``budget`` Gaussians."""
    distances = np.log(_distances(ranges.boxes, camera))
    num_levels, num_chunks = ranges.counts.shape
    chunk = np.arange(num_chunks)
    has = ranges.counts > 0
    # What stands for each level: itself, the next finer that there is, or the finest.
    present = np.maximum.accumulate(np.where(has, np.arange(num_levels)[:, None], -1), axis=0)
    present = np.where(present < 0, has.argmax(axis=0), present)

    def levels_at(shift: float) -> Array:
        wanted = np.clip(np.floor((distances - shift) / np.log(band)) + 1, 0, num_levels - 1).astype(np.int64)
        return np.asarray(present[wanted, chunk])

    def fits(levels: Array) -> bool:
        return int(ranges.counts[levels, chunk].sum()) <= budget

    coarse = float(distances.min()) - num_levels * np.log(band) - 1
    fine = float(distances.max()) + 1
    if fits(levels_at(fine)):
        return levels_at(fine)
    for _ in range(_HALVINGS):
        middle = (coarse + fine) / 2
        coarse, fine = (middle, fine) if fits(levels_at(middle)) else (coarse, middle)
    return levels_at(coarse)


def select_by_errors(ranges: Ranges, camera: Camera, budget: int) -> Int64[Array, "c"]:
    """The level of each chunk by the errors of the stream, which has them and all levels of all chunks."""
    assert ranges.errors is not None
    table: Array = ranges.errors
    radii = np.linalg.norm(ranges.boxes[:, 1] - ranges.boxes[:, 0], axis=1) / 2
    coverages = (radii / (radii + _distances(ranges.boxes, camera))) ** 2
    levels = np.empty(len(radii), np.int64)
    ladders: list[list[int]] = []  # levels that are worth having, coarse to fine
    heap: list[tuple[float, int, int]] = []  # − worth, chunk, the next step

    def offer(chunk: int, step: int) -> None:
        """Put a chunk's next step on the heap: it is worth as much as the best way on from here."""
        if step < len(ladders[chunk]):
            now, further = ladders[chunk][step - 1], ladders[chunk][step:]
            counts, errors = ranges.counts[:, chunk], table[:, chunk]
            worth = ((errors[now] - errors[further]) / (counts[further] - counts[now])).max()
            heapq.heappush(heap, (-coverages[chunk] * worth, chunk, step))

    for chunk, (counts, errors) in enumerate(zip(ranges.counts.T.tolist(), table.T.tolist(), strict=True)):
        by_count = sorted(range(len(counts)), key=lambda level: (counts[level], errors[level]))
        useful = by_count[:1]
        for level in by_count[1:]:
            if errors[level] < errors[useful[-1]]:
                useful.append(level)
        ladders.append(useful)
        levels[chunk] = useful[0]
        offer(chunk, 1)
    left = budget - int(ranges.counts[levels, np.arange(len(levels))].sum())
    while heap:
        _, chunk, step = heapq.heappop(heap)
        left -= int(ranges.counts[ladders[chunk][step], chunk] - ranges.counts[ladders[chunk][step - 1], chunk])
        if left < 0:
            break
        levels[chunk] = ladders[chunk][step]
        offer(chunk, step + 1)
    return levels


def _distances(boxes: Float64[Array, "c 2 3"], camera: Camera) -> Float64[Array, "c"]:
    half = (boxes[:, 1] - boxes[:, 0]) / 2
    usual = np.sort(half, axis=0)[len(half) // 2]
    trim = np.maximum(0, half - usual) * _SHRINK
    eye = camera.position
    away = np.clip(eye, boxes[:, 0] + trim, boxes[:, 1] - trim) - eye
    distances = np.linalg.norm(away, axis=1)
    ahead = away @ camera.camera_from_world[2, :3]
    is_behind = (ahead < 0) & (distances > 1e-2)
    distances[is_behind] *= 1 - ahead[is_behind] / distances[is_behind] * (_BEHIND - 1)
    half_fov = min(camera.width / camera.K[0, 0], camera.height / camera.K[1, 1]) / 2  # its tangent
    return np.asarray(np.maximum(distances * half_fov / np.tan(np.radians(22.5)), 1e-6))
