"""A trace on a machine, as the numbers that the cycle-stepped core takes, and the bounds that follow from them alone."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.hardware.cache import misses_of
from splatree.hardware.config import Machine
from splatree.hardware.levels import RECORDS_PER_UNIT
from splatree.hardware.trace import SUBTILE_PX, FrameTrace
from splatree.maths.morton import morton_codes
from splatree.shapes import Array, Int32, Int64

__all__ = ["Bounds", "Work", "bounds_of", "dram_settings", "work_of"]

FIDELITIES = {"L0": 0, "L1": 1, "L2": 2}


@dataclass(frozen=True, eq=False)
class Work:
    """What the core steps through."""

    settings: dict[str, Any]
    """Numbers of the machine in cycles and bytes."""
    clusters: dict[str, Array]
    """Columns of the clusters, and the order of visits."""
    tiles: dict[str, Int64[Array, "t"]]
    """Columns of the tiles, in the order in which they are drawn."""
    evaluations: int
    """Evaluations of a splat at a pixel that the renderers do."""
    cache_misses: int
    """Lines of projected records that are read."""
    cache_accesses: int
    """Entries whose record is looked up."""


@dataclass(frozen=True)
class Bounds:
    """Cycles that a frame takes at least, by what bounds it."""

    dram: float
    """Bytes of the front end over the bandwidth."""
    identification: float
    """Clusters times the interval."""
    selection: float
    """Rows that the selection of levels looks at, over its lanes."""
    step1: float
    """Rows of kept clusters over the lanes."""
    step2: float
    """Survivors over the lanes."""
    distribution: float
    """Pairs over the pairs of a cycle."""
    back_dram: float
    """Bytes of the back end over the bandwidth."""
    sort: float
    """Cycles of all lists in the sorter."""
    blend: float
    """Cycles of all tiles over the renderers."""

    @property
    def front(self) -> float:
        """The front end's least time: the largest of its bounds."""
        return max(self.dram, self.identification, self.selection, self.step1, self.step2, self.distribution)

    @property
    def back(self) -> float:
        """The back end's least time."""
        return max(self.back_dram, self.sort, self.blend)

    @property
    def named(self) -> str:
        """What bounds the front end."""
        names = ("dram", "identification", "selection", "step1", "step2", "distribution")
        return max(names, key=lambda name: float(getattr(self, name)))


def work_of(machine: Machine, trace: FrameTrace, visits: Int32[Array, "s"]) -> Work:
    """The work of a frame on a machine."""
    if not machine.clustering:  # every cluster is read, in the order of the file
        visits = np.argsort(trace.cluster_first_row, kind="stable").astype(np.int32)
    records, line = machine.records, machine.dram.line_bytes
    tiles, evaluations, misses, accesses = _tiles_of(machine, trace)
    num_pairs = max(int(trace.cluster_pairs.sum()), 1)
    list_lines = -(-trace.tile_length * records.pair // line)
    halves = 2 if machine.ping_pong else 1
    colors = records.color(trace.num_coefficients)
    geometry_base = 1 << 30
    if trace.has_levels and not machine.selects_levels:
        raise InputError(
            f"simulate: found a frame of levels of detail, but {machine.name!r} cannot select them; set selects_levels=true, or "
            "draw all leaves with a pixel error of 0"
        )
    settings = {
        "dram": dram_settings(machine),
        "identifies": machine.clustering,
        "interval": machine.identification.interval,
        "latency": machine.identification.latency,
        "record_fifo": machine.identification.record_fifo,
        "selected_fifo": machine.identification.selected_fifo,
        "record_bytes": records.cluster(exact=machine.identification.rule != "paper"),
        "selects_levels": trace.has_levels,
        "levels": _engine_of(machine.levels.lanes, machine.levels.latency, machine.rows_of_levels, halves)
        | {"row_bytes": records.level, "base": 2 * geometry_base},
        "geometry": _engine_of(machine.step1.lanes, machine.step1.latency, machine.rows_of_step1, halves)
        | {"row_bytes": records.geometry, "base": geometry_base},
        "color": _engine_of(
            machine.step2.lanes, machine.step2.latency, machine.rows_of_step2(trace.num_coefficients), halves
        )
        | {"row_bytes": colors, "base": 4 * geometry_base},
        "streamed_share": machine.step2.streamed_share,
        "splat_bytes": records.splat,
        "pair_bytes": records.pair,
        "pairs_per_cycle": machine.back.pairs_per_cycle,
        "pair_backlog": int(machine.back.bin_kb * 1024 // records.pair),
        "list_lines_per_pair": float(list_lines.sum()) / num_pairs,
        "renderers": machine.back.renderers,
        "sort_latency": machine.back.sort_latency,
        "blend_latency": machine.back.blend_latency,
        "tiles_waiting": halves,
        "overlaps": machine.back.overlaps,
    }
    clusters = {
        "visits": np.ascontiguousarray(visits, np.int32),
        "first_row": trace.cluster_first_row,
        "span_rows": trace.cluster_span,
        "rows": trace.cluster_rows,
        "walked": trace.cluster_walked,
        "walk_lines": -(-trace.cluster_walk_units * RECORDS_PER_UNIT * records.level // line),
        "survivors": trace.cluster_survivors,
        "pairs": trace.cluster_pairs,
    }
    clusters |= {name: np.ascontiguousarray(column, np.int64) for name, column in clusters.items() if name != "visits"}
    return Work(settings, clusters, tiles, evaluations, misses, accesses)


def _engine_of(lanes: float, latency: int, capacity: int, halves: int) -> dict[str, Any]:
    return {"lanes": lanes, "latency": latency, "capacity": capacity, "halves": halves}


def dram_settings(machine: Machine) -> dict[str, Any]:
    """The DRAM in the numbers of the core: times in cycles of the machine's clock."""
    dram = machine.dram
    whole = ("line_bytes", "row_bytes", "channels", "banks", "interleave_bytes", "window", "write_batch")
    timed = (
        "activate",
        "precharge",
        "row_active",
        "activate_gap",
        "four_activates",
        "turn",
        "refresh",
        "refresh_interval",
    )
    return {
        "fidelity": FIDELITIES[dram.fidelity],
        "bytes_per_cycle": machine.bytes_per_cycle,
        "latency": round(machine.cycles(dram.latency_ns)),
        **{name: getattr(dram, name) for name in whole},
        **{name: machine.cycles(getattr(dram, f"{name}_ns")) for name in timed},
    }


def _tiles_of(machine: Machine, trace: FrameTrace) -> tuple[dict[str, Int64[Array, "t"]], int, int, int]:
    """Columns of the tiles in the order in which they are drawn; evaluations, lines missed and looked up."""
    across, down = (int(n) for n in trace.num_tiles_xy)
    order = np.arange(across * down)
    if machine.back.tile_order == "morton":
        x, y = order % max(across, 1), order // max(across, 1)
        order = np.argsort(morton_codes(np.stack([x, y, 0 * x], axis=1).astype(np.float32)), kind="stable")
    length, consumed = trace.tile_length[order], trace.tile_consumed[order]
    pixels = SUBTILE_PX**2
    subtiles = trace.tile_subtiles[order] if machine.back.skips_subtiles else 4 * consumed
    cycles = -(-subtiles * pixels // machine.back.lanes)
    keys = np.maximum(length, 1)
    sort = np.ceil(keys * np.maximum(np.ceil(np.log2(keys)), 0) / machine.back.sort_keys) + machine.back.sort_latency
    sort[length == 0] = 0
    misses = misses_of(machine, trace, order)
    line = machine.dram.line_bytes
    tiles = {
        "list_lines": -(-length * machine.records.pair // line),
        "sort_cycles": sort.astype(np.int64),
        "projected_lines": misses,
        "blend_cycles": cycles,
        "frame_lines": np.full(len(order), -(-4 * pixels * 4 // line), np.int64),
    }
    columns = {name: np.ascontiguousarray(column, np.int64) for name, column in tiles.items()}
    return columns, int(subtiles.sum()) * pixels, int(misses.sum()), int(consumed.sum())


def bounds_of(machine: Machine, work: Work, lines: dict[str, int]) -> Bounds:
    """Least cycles of a frame whose streams took these lines."""
    line, width = machine.dram.line_bytes, machine.bytes_per_cycle
    clusters, tiles = work.clusters, work.tiles
    visited = clusters["visits"][clusters["visits"] >= 0]
    front = ("records", "levels", "geometry", "color", "projected", "pairs")
    back = ("lists", "splats", "frame")
    rows, survivors, pairs = (float(clusters[name][visited].sum()) for name in ("rows", "survivors", "pairs"))
    return Bounds(
        dram=sum(lines[name] for name in front) * line / width,
        identification=float(len(clusters["visits"]) * machine.identification.interval) if machine.clustering else 0.0,
        selection=float(clusters["walked"][visited].sum()) / machine.levels.lanes,
        step1=rows / machine.step1.lanes,
        step2=survivors / machine.step2.lanes,
        distribution=pairs / machine.back.pairs_per_cycle,
        back_dram=sum(lines[name] for name in back) * line / width,
        sort=float(tiles["sort_cycles"].sum()),
        blend=math.ceil(float(tiles["blend_cycles"].sum()) / machine.back.renderers),
    )
