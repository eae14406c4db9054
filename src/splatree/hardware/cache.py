"""The cache of projected records: each entry of a list looks up one line; tiles that lie beside each other share most of them."""

import numpy as np

from splatree.hardware.config import Machine
from splatree.hardware.trace import FrameTrace
from splatree.kernels.cpu import _core
from splatree.shapes import Array, Int64

__all__ = ["MISS_RATE", "misses_of"]

MISS_RATE = 0.8
"""Share of entries whose record is not in the cache where a trace has no lists: a flight out of a chunk of a city measured 0.65
near by, 0.88 and 1.0 far away, where each splat is listed in one tile."""


def misses_of(machine: Machine, trace: FrameTrace, order: Int64[Array, "t"]) -> Int64[Array, "t"]:
    """Lines that each tile reads, tiles in the given order: LRU in sets, the line's set by its number."""
    consumed = trace.tile_consumed[order]
    if len(trace.pair_splats) == 0:
        return np.ceil(MISS_RATE * consumed).astype(np.int64)
    ways = machine.back.cache_ways
    sets = int(machine.back.cache_kb * 1024 // (machine.dram.line_bytes * ways))
    misses = np.zeros(len(order), np.int64)
    _core.cache_misses(
        splats=trace.pair_splats,
        start=np.ascontiguousarray(trace.tile_start, np.int64),
        order=np.ascontiguousarray(order, np.int64),
        sets=sets,
        ways=ways,
        misses=misses,
    )
    return misses
