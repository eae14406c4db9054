"""Cells: boxes that tile space and hold about equally many rows.

A sample of the means is halved across its longest side (1 to 99 % quantiles, so that outliers do not decide) until few enough
rows are expected in each box. Where that takes an odd number of boxes, the cut is at the quantile that gives all of them the same
share: boxes as large as allowed have the least around them. Where a cut would separate nothing, as among rows at one place,
halving ends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatree.lod.region import EVERYWHERE, Box
from splatree.shapes import Array, Int32

__all__ = ["Cells", "halve"]


@dataclass(frozen=True)
class Cells:
    """A tree of halvings, and the boxes that its ends are."""

    halvings: tuple[tuple[int, float, int, int], ...]
    """Axis and place of each plane, and what lies below and above it: a halving by its number, or cell i as −1 − i. The first
    is that of all space; none: there is one cell."""
    boxes: tuple[Box, ...]
    """The box of each cell."""

    def __len__(self) -> int:
        return len(self.boxes)

    def of(self, points: Array) -> Int32[Array, "n"]:
        """The cell of each point (n 3)."""
        cells = np.zeros(len(points), np.int32)
        if not self.halvings:
            return cells
        waiting = [(0, np.arange(len(points)))]
        while waiting:
            number, rows = waiting.pop()
            axis, at, below, above = self.halvings[number]
            is_below = points[rows, axis] < at
            for side, inside in ((below, rows[is_below]), (above, rows[~is_below])):
                if side < 0:
                    cells[inside] = -1 - side
                elif len(inside):
                    waiting.append((side, inside))
        return cells

    @staticmethod
    def of_halvings(halvings: Sequence[Sequence[Any]]) -> "Cells":
        """The cells of halvings, as they are kept in a file."""
        kept = tuple((int(axis), float(at), int(below), int(above)) for axis, at, below, above in halvings)
        boxes: dict[int, Box] = {} if kept else {0: EVERYWHERE}
        waiting = [(0, EVERYWHERE)] if kept else []
        while waiting:
            number, box = waiting.pop()
            axis, at, below, above = kept[number]
            for side, half in zip((below, above), box.halved(axis, at), strict=True):
                if side < 0:
                    boxes[-1 - side] = half
                else:
                    waiting.append((side, half))
        return Cells(kept, tuple(boxes[i] for i in range(len(boxes))))


def halve(sample: Array, sample_rows: float) -> Cells:
    """The cells that hold at most ``sample_rows`` of the points of a sample (n 3), where cuts can separate them."""
    halvings: list[list[float]] = []
    num_cells = 0

    def end() -> int:
        nonlocal num_cells
        num_cells += 1
        return -num_cells

    def split(points: Array) -> int:
        count = math.ceil(len(points) / max(sample_rows, 1) * (1 - 1e-9))
        if count <= 1:
            return end()
        place = len(points) * (count // 2) // count
        spread = np.quantile(points, 0.99, axis=0) - np.quantile(points, 0.01, axis=0)
        for axis in np.argsort(-spread, kind="stable"):
            at = np.partition(points[:, axis], place)[place]  # equal coordinates stay together
            is_below = points[:, axis] < at
            if is_below.any() and not is_below.all():
                number = len(halvings)
                halvings.append([])
                below, above = split(points[is_below]), split(points[~is_below])
                halvings[number] = [int(axis), float(at), below, above]
                return number
        return end()

    split(np.asarray(sample, np.float32))
    return Cells.of_halvings(halvings)
