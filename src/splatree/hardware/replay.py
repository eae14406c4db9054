"""The DRAM alone: addresses of a frame's front end, and the time that the model takes to read them; for checks against others."""

import numpy as np

from splatree.hardware.config import Machine
from splatree.hardware.engines import Work, dram_settings
from splatree.kernels.cpu import _core
from splatree.shapes import Array, Bool, Int64

__all__ = ["front_addresses", "replay_ms"]


def front_addresses(machine: Machine, work: Work, most: int) -> Int64[Array, "a"]:
    """Addresses of the lines that step 1 and step 2 read for the first visited clusters, in turn, at most so many.

    Args:
        machine: the accelerator.
        work: what `engines.work_of` makes of it and a trace without levels.
        most: lines that are wanted.
    """
    line, columns = machine.dram.line_bytes, work.clusters
    parts: list[Array] = []
    count = 0
    for cluster in columns["visits"][columns["visits"] >= 0]:
        first, rows, survivors = (int(columns[name][cluster]) for name in ("first_row", "rows", "survivors"))
        for stream, wanted in (("geometry", rows), ("color", survivors)):
            size, base = (work.settings[stream][name] for name in ("row_bytes", "base"))
            starts = base + size * (first + np.arange(wanted) * rows // max(wanted, 1))
            lines = starts[:, None] // line + np.arange(-(-size // line) + 1)
            parts.append(np.unique(lines[lines * line < starts[:, None] + size]) * line)
            count += len(parts[-1])
        if count >= most:
            break
    return np.concatenate([np.zeros(0, np.int64), *parts])[:most].astype(np.int64)


def replay_ms(machine: Machine, addresses: Int64[Array, "a"], writes: Bool[Array, "a"] | None = None) -> float:
    """Milliseconds in which the DRAM serves a line at each address, asked for as fast as it takes them.

    Args:
        machine: the accelerator.
        addresses: of the lines, in bytes; reads are taken in their order, and so are writes.
        writes: which lines are written; None: none.
    """
    is_write = np.zeros(len(addresses), bool) if writes is None else np.ascontiguousarray(writes, bool)
    cycles = _core.replay(dram_settings(machine), np.ascontiguousarray(addresses, np.int64), is_write)
    return float(cycles / machine.clock_mhz / 1e3)
