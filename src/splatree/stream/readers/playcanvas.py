"""The levels that PlayCanvas 2.23 chooses of a streamed SOG: bands of distance, moved until a budget of Gaussians is met.

The distance of a chunk is that of its box from the eye. Of a box whose half side is longer than the median half side of all
boxes, three quarters of what is longer are taken off first. A chunk behind the eye counts as up to 1.5 times as far. The
distance is then scaled by tan(fov / 2) of the smaller field of view against that of 45°. The level is one of bands that each
are three times as deep as the one before; all bands move together, to the finest place where the sum of all chunks fits the
budget. A chunk without the level takes its next finer one, or its coarsest if it has none that coarse.

PlayCanvas 2.22 can choose by tables of errors instead (`select_by_errors`). All chunks begin at their coarsest level. A step to a
finer level is worth c Δerror / Δcount, the best of the ways on to a finer one; c = (r / (r + distance))² for a chunk of radius r.
There boxes are whole, and a chunk behind the eye is as far as it is. Worths fall into 512 classes, each about a fifth larger than
the next; steps are taken class by class from the most worth, within a class in turn, until one does not fit the budget. Levels
that have more rows than another one and no smaller error are left out.

Both versions put the rows of each file that is drawn into a square texture, and take from the budget what the last line of each
file would leave empty. The texture has place for 1.15 times the budget. So a choice depends on the files of the choice before;
here it is made again until its own files lead to it. The engine makes it again whenever a file has come, and may end at a choice
beside that, with one or two files more or less.
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from splatree.scene.cameras import Camera
from splatree.shapes import Array, Float64, Int64
from splatree.stream.readers.sog_stream import Ranges

__all__ = ["select_by_errors", "select_playcanvas"]

_SHRINK, _BEHIND, _BAND = 0.75, 1.5, 3.0
_HALVINGS = 40

_ROOM = 1.15
"""Rows that the texture has place for, for each of the budget."""

_ROUNDS = 8
"""Choices that follow each other before one is kept: two sets of files can lead to each other."""

_CLASSES = 512
"""Classes of worth: equal shares of the bits of 32-bit floats between the least and the most worth."""
_LEAST_WORTH, _MOST_WORTH = 1e-24, 1e3


def select_playcanvas(ranges: Ranges, camera: Camera, budget: int, *, band: float = _BAND) -> Int64[Array, "c"]:
    """The level of each chunk; the coarsest of all where even that is more than ``budget`` Gaussians."""
    distances = np.log(_distances(_shrunk(ranges.boxes), camera, behind=_BEHIND))
    num_levels, num_chunks = ranges.counts.shape
    chunk = np.arange(num_chunks)
    has = ranges.counts > 0
    # What stands for each level: itself, the next finer that there is, or the finest.
    present = np.maximum.accumulate(np.where(has, np.arange(num_levels)[:, None], -1), axis=0)
    present = np.where(present < 0, has.argmax(axis=0), present)

    def levels_at(shift: float) -> Array:
        wanted = np.clip(np.floor((distances - shift) / np.log(band)) + 1, 0, num_levels - 1).astype(np.int64)
        return np.asarray(present[wanted, chunk])

    coarse = float(distances.min()) - num_levels * np.log(band) - 1
    fine = float(distances.max()) + 1

    def within(room: int) -> Array:
        def fits(levels: Array) -> bool:
            return int(ranges.counts[levels, chunk].sum()) <= room

        if fits(levels_at(fine)):
            return levels_at(fine)
        low, high = coarse, fine
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if fits(levels_at(middle)) else (low, middle)
        return levels_at(low)

    return _settled(ranges, budget, within)


def select_by_errors(ranges: Ranges, camera: Camera, budget: int) -> Int64[Array, "c"]:
    """The level of each chunk by the errors of the stream, which has them and all levels of all chunks."""
    assert ranges.errors is not None
    table: Array = ranges.errors
    radii = np.linalg.norm(ranges.boxes[:, 1] - ranges.boxes[:, 0], axis=1) / 2
    coverages = ((radii / (radii + _distances(ranges.boxes, camera, behind=1.0))) ** 2).astype(np.float32).tolist()
    ladders = [
        _useful(counts, errors) for counts, errors in zip(ranges.counts.T.tolist(), table.T.tolist(), strict=True)
    ]
    start = np.array([ladder[0] for ladder in ladders])
    chunk = np.arange(len(ladders))

    def worth(chunk: int, step: int) -> float:
        """What a chunk's step is worth: as much as the best way on from the level before it."""
        now, further = ladders[chunk][step - 1], ladders[chunk][step:]
        counts, errors = ranges.counts[:, chunk], table[:, chunk]
        return float(np.float32(((errors[now] - errors[further]) / (counts[further] - counts[now])).max()))

    def within(room: int) -> Array:
        levels = start.copy()
        queues: list[deque[tuple[int, int]]] = [deque() for _ in range(_CLASSES)]  # of a chunk and its next step
        for c, ladder in enumerate(ladders):
            if len(ladder) > 1:
                queues[_class_of(coverages[c] * worth(c, 1))].append((c, 1))
        left = room - int(ranges.counts[levels, chunk].sum())
        for own in reversed(range(_CLASSES)):
            while queues[own]:
                c, step = queues[own].popleft()
                left -= int(ranges.counts[ladders[c][step], c] - ranges.counts[ladders[c][step - 1], c])
                if left < 0:
                    return levels
                levels[c] = ladders[c][step]
                if step + 1 < len(ladders[c]):
                    queues[min(own, _class_of(coverages[c] * worth(c, step + 1)))].append((c, step + 1))
        return levels

    return _settled(ranges, budget, within)


def _useful(counts: list[int], errors: list[float]) -> list[int]:
    """The levels of a chunk that are worth having, coarse to fine."""
    by_count = sorted(range(len(counts)), key=lambda level: (counts[level], errors[level]))
    useful = by_count[:1]
    for level in by_count[1:]:
        if errors[level] < errors[useful[-1]]:
            useful.append(level)
    return useful


def _class_of(worth: float) -> int:
    low, high = _bits(_LEAST_WORTH), _bits(_MOST_WORTH)
    return min(max(int((_bits(worth) - low) * ((_CLASSES - 1) / (high - low))), 0), _CLASSES - 1)


def _bits(value: float) -> int:
    """The bits of a 32-bit float, which grow with it."""
    return int(np.float32(value).view(np.uint32))


def _settled(ranges: Ranges, budget: int, within: Callable[[int], Array]) -> Int64[Array, "c"]:
    """The levels ``within`` the room that the last lines of their own files leave of the budget."""
    width = math.ceil(math.sqrt(math.ceil(_ROOM * budget)))
    in_file = np.zeros(int(ranges.files.max()) + 1, np.int64)  # rows
    has = ranges.files >= 0
    np.maximum.at(in_file, ranges.files[has], (ranges.offsets + ranges.counts)[has])
    levels = within(budget)
    for _ in range(_ROUNDS):
        chosen = ranges.files[levels, np.arange(len(levels))]
        empty = int((-in_file[np.unique(chosen[chosen >= 0])] % width).sum())
        before, levels = levels, within(max(1, budget - empty))
        if np.array_equal(before, levels):
            break
    return np.asarray(levels, np.int64)


def _shrunk(boxes: Float64[Array, "c 2 3"]) -> Float64[Array, "c 2 3"]:
    """Boxes without three quarters of what their half sides have beyond the median."""
    half = (boxes[:, 1] - boxes[:, 0]) / 2
    usual = np.sort(half, axis=0)[len(half) // 2]
    trim = np.maximum(0, half - usual) * _SHRINK
    return np.stack([boxes[:, 0] + trim, boxes[:, 1] - trim], axis=1)


def _distances(boxes: Float64[Array, "c 2 3"], camera: Camera, *, behind: float) -> Float64[Array, "c"]:
    """Distance of each box; straight behind the eye it counts ``behind`` times."""
    eye = camera.position
    away = np.clip(eye, boxes[:, 0], boxes[:, 1]) - eye
    distances = np.linalg.norm(away, axis=1)
    ahead = away @ camera.camera_from_world[2, :3]
    is_behind = (ahead < 0) & (distances > 1e-2)
    distances[is_behind] *= 1 - ahead[is_behind] / distances[is_behind] * (behind - 1)
    half_fov = min(camera.width / camera.K[0, 0], camera.height / camera.K[1, 1]) / 2  # its tangent
    return np.asarray(np.maximum(distances * half_fov / np.tan(np.radians(22.5)), 1e-6))
