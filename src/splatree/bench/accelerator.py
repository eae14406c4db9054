"""The accelerator of Jo 2024, §4.4: Table II, Figures 8 and 9, simulated with Table I's rates, each figure beside the paper's.

The verdict is one of four words. *reproduced*: our figure follows from the paper's own numbers, and is theirs. *consistent*: it
follows with an assumption that the paper does not make, which is named. *not reproducible*: it cannot follow from what is
published, and why. *not run*: it was not tried, and what that would need.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatree.bench import jo2024
from splatree.bench.experiment import Curve, Lanes, Plot, Report, Row, Table
from splatree.bench.provenance import machine as processor
from splatree.bench.provenance import program
from splatree.errors import InputError
from splatree.hardware.area import area_of
from splatree.hardware.config import Format, Machine, Records
from splatree.hardware.energy import energy_of
from splatree.hardware.paper import (
    COUNTS,
    RATES,
    SpeedUp,
    compulsory_ms,
    compulsory_speed_up,
    fitted_common_ms,
    speed_up_of_clustering,
    traces_of_table_i,
)
from splatree.hardware.presets import changed, preset
from splatree.hardware.simulate import FrameTime, simulate_frame

__all__ = ["Options", "run"]

A6000_MS = 1e3 / 134
"""A frame of 3DGS on an RTX A6000: 134 frames a second, mean of Mip-NeRF 360 (Kerbl 2023, Table 1, 30k)."""
AREA_TOLERANCE = 0.05
"""Share by which an area made of other people's blocks may differ and still be called consistent."""
SPEED_UP_TOLERANCE = 0.03
"""Share by which a speed-up may differ: the paper prints three digits, and the counts of Gaussians are not its own."""
CONTROL_SHARE = 0.10
"""Area of control beside the logic's blocks (assumed)."""
FORMATS: tuple[Format, ...] = ("fp16", "fp32")
WITHOUT_SOURCE = "the rest has no published source: leakage, clock tree, pads, or larger engines"


@dataclass(frozen=True)
class Options:
    """Simulate the accelerator of Jo 2024 with Table I's rates: Table II, Figures 8 and 9, its speed-ups with verdicts."""

    preset: str = "jo2024"
    """Machine to start from: jo2024, gscore-like, neo-like or splatree."""
    set: tuple[str, ...] = ()
    """Settings of the machine, such as step1.lanes=1 records.format=fp16."""
    share: float = 1.0
    """Share of each scene's Gaussians and clusters that is simulated, for quick runs."""
    shown: str = "Bicycle"
    """Scene of Table I whose frame Figure 8 shows."""

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise InputError(f"share: found {self.share}, wanted more than 0 and at most 1")
        if self.shown not in COUNTS:
            raise InputError(f"shown: found {self.shown!r}, wanted one of {', '.join(COUNTS)}")


def run(options: Options) -> Report:
    """Simulate the scenes of Table I with and without clusters, and set all figures beside the paper's."""
    machine = changed(preset(options.preset), options.set)
    trace = traces_of_table_i(share=options.share)[options.shown]
    frame = simulate_frame(machine, [trace])
    single = simulate_frame(replace(machine, ping_pong=False), [trace])
    watts = energy_of(frame, int(trace.tile_blended.sum()))
    found = speed_up_of_clustering(machine, share=options.share)
    dram_w = watts.dram / frame.milliseconds
    tables = [
        Table(
            "accelerator_table2", "Table II: the chip", _chip_rows(machine, watts.total / frame.milliseconds, dram_w)
        ),
        Table("accelerator_fig8", f"Figure 8: the time line of a frame, {options.shown}", _line_rows(frame, single)),
        Table(
            "accelerator_fig9",
            "Figure 9: the front end with and without clusters",
            _scene_rows(machine, found),
            notes=NOTES,
        ),
        Table("accelerator_sensitivity", "What the speed-up of clustering hangs on", _sensitivity_rows(machine)),
        Table("accelerator_gpu", "Against a GPU: what the paper's factors need", _gpu_rows(machine), notes=GPU_NOTES),
        Table("accelerator_verdicts", "The paper's speed-ups, and ours", _verdict_rows(machine, found)),
        jo2024.table_ii(),
    ]
    about = {
        "scenes": f"Mip-NeRF 360: Table I's rates, {options.share:.0%} of 3DGS's Gaussians (taming-3dgs)",
        "accelerator": f"{machine.name}, {machine.clock_mhz:g} MHz, {machine.dram.bandwidth_gbps:g} GB/s, "
        f"{machine.records.format}, settings {' '.join(options.set) or 'as in the preset'}",
        "machine": processor(),
        "version": program(),
    }
    figures: list[Lanes | Plot] = [_time_line(frame, options.shown), _speed_ups(found, machine)]
    return Report("accelerator", "The accelerator of Jo 2024 beside its paper", about, tables, figures)


NOTES = (
    "bytes: those that must be read, nothing fitted. simulated: steps 0 to 2 at fidelity L0, lines that are read in part, "
    "projected records written.",
    "Figure 9 prints its bars as a picture only; the text has their means.",
)
GPU_NOTES = (
    "least frame: the bytes that must be read over the bandwidth, mean of the scenes, with clusters; a whole frame takes longer.",
    "A6000: 134 frames a second, the mean that Kerbl 2023 prints for these scenes. No GPU was measured here.",
)


def _chip_rows(machine: Machine, all_w: float, dram_w: float) -> list[Row]:
    """Table II beside ours; what we set to the paper's value is no result."""
    area = area_of(machine)
    control = CONTROL_SHARE * sum(block.mm2 for block in area.blocks if "SRAM" not in block.name)
    ours = {
        "area": area.mm2 + control,
        "frequency": machine.clock_mhz,
        "DRAM bandwidth": machine.dram.bandwidth_gbps,
        "SRAM": machine.sram_kb / 1024,
        "technology": 28.0,
        "power": area.watts + machine.static_w + dram_w,
    }
    rows: list[Row] = []
    for what, (unit, theirs, _) in jo2024.TABLE_II.items():
        verdict = "not run (an input of the simulation)"
        if what in ("area", "power"):
            verdict = _verdict(ours[what], theirs, AREA_TOLERANCE, "a fit to GSCore's blocks", WITHOUT_SOURCE)
        rows.append({"what": what, "unit": unit, "ours": ours[what], "paper": theirs, "verdict": verdict})
    rows += [{"what": f"of the area: {block.name}", "unit": "mm2", "ours": block.mm2} for block in area.blocks]
    rows.append({"what": "of the area: control, 10 % of the logic (assumed)", "unit": "mm2", "ours": control})
    parts = {"blocks, all busy": area.watts, "static (assumed)": machine.static_w, "DRAM": dram_w}
    rows += [{"what": f"of the power: {what}", "unit": "W", "ours": value} for what, value in parts.items()]
    rows.append({"what": "power by the energy of events instead", "unit": "W", "ours": all_w})
    return rows


def _verdict(ours: float, theirs: float, tolerance: float, assumed: str, why: str) -> str:
    return f"consistent ({assumed})" if abs(ours / theirs - 1) <= tolerance else f"not reproducible ({why})"


def _line_rows(frame: FrameTime, single: FrameTime) -> list[Row]:
    """When each engine works, and whether the engines overlap as the figure shows."""
    microsecond = frame.machine.clock_mhz
    rows: list[Row] = [
        {
            "what": name,
            "first work us": unit.first_start / microsecond,
            "last us": unit.last_end / microsecond,
            "busy %": 100 * unit.busy / max(frame.cycles, 1),
            "waits for data %": 100 * unit.stalled_on_input / max(frame.cycles, 1),
            "waits for room %": 100 * unit.stalled_on_output / max(frame.cycles, 1),
        }
        for name, unit in frame.units.items()
        if unit.items
    ]
    units = frame.units
    claims = {
        "step 1 starts while clusters are identified": (units["step1"], units["identification"]),
        "step 2 starts while step 1 works": (units["step2"], units["step1"]),
    }
    for claim, (later, earlier) in claims.items():
        holds = 0 <= later.first_start < earlier.last_end
        rows.append({"what": claim, "verdict": "reproduced" if holds else "not reproducible (on this machine)"})
    gain = single.front_cycles / max(frame.front_cycles, 1)
    rows.append({"what": f"ping-pong buffers: the front end is {gain:.2f} times as fast as with single ones"})
    return rows


def _scene_rows(machine: Machine, found: SpeedUp) -> list[Row]:
    return [
        {
            "scene": scene,
            "Gaussians": count,
            "excluded %": 100 * RATES[scene].exclusion,
            "ideal %": 100 * RATES[scene].ideal,
            "fp16 bytes ms": compulsory_ms(replace(machine, records=Records("fp16")), scene, clustering=True),
            "speed-up by bytes": _by_bytes(machine, scene),
            "simulated ms": found.milliseconds[scene][1],
            "simulated without ms": found.milliseconds[scene][0],
            "speed-up simulated": found.of_scene[scene],
        }
        for scene, count in COUNTS.items()
    ]


def _sensitivity_rows(machine: Machine) -> list[Row]:
    """The speed-up by bytes and lanes over the format, the lanes of step 1 and the time that clusters do not change."""
    rows: list[Row] = []
    theirs = jo2024.SPEED_UPS["clustering on the accelerator, mean"]
    for name in FORMATS:
        for lanes in (1.0, 2.0, 4.0):
            step1 = replace(machine.step1, lanes=lanes)
            one = replace(machine, records=Records(name), step1=step1)
            row: dict[str, object] = {"format": name, "lanes of step 1": lanes}
            for common in (0.0, 0.5, 1.0, 2.0, 4.0):
                row[f"+{common:g} ms"] = compulsory_speed_up(one, common)
            rows.append(row | {f"common ms for {theirs:g}": fitted_common_ms(one, theirs)})
    return rows


def least_frame_ms(machine: Machine, records: Records) -> float:
    """Mean over the scenes of the bytes that must be read, with clusters, over the bandwidth."""
    one = replace(machine, records=records)
    return float(np.mean([compulsory_ms(one, scene, clustering=True) for scene in COUNTS]))


def _gpu_rows(machine: Machine) -> list[Row]:
    rows: list[Row] = []
    for name in FORMATS:
        least = least_frame_ms(machine, Records(name))
        row: dict[str, object] = {"format": name, "least frame ms": least}
        for claim in ("accelerator over GPU, mean", "accelerator over GPU, largest"):
            factor = jo2024.SPEED_UPS[claim]
            row[f"GPU ms for {factor:g}"] = factor * least
        row |= {"A6000 ms": A6000_MS, "speed-up over it at most": A6000_MS / least}
        rows.append(row)
    return rows


def _verdict_rows(machine: Machine, found: SpeedUp) -> list[Row]:
    paper = jo2024.SPEED_UPS
    on_gpu, on_chip, mean, largest = paper
    fp16 = replace(machine, records=Records("fp16"))
    near = {
        "by bytes, nothing fitted": compulsory_speed_up(fp16),
        "by bytes, and 1 ms that clusters do not change (fitted)": compulsory_speed_up(fp16, 1.0),
        "simulated, nothing fitted": found.simulated,
    }
    rows: list[Row] = [
        {"claim": on_gpu, "ours": None, "paper": paper[on_gpu], "verdict": "not run (needs a GPU and their packing)"}
    ]
    assumed, why = "counts and formats assumed", "lines read in part and what is written are left out"
    for how, ours in near.items():
        verdict = _verdict(ours, paper[on_chip], SPEED_UP_TOLERANCE, assumed, why)
        rows.append({"claim": f"{on_chip}: {how}", "ours": ours, "paper": paper[on_chip], "verdict": verdict})
    least, most = (least_frame_ms(machine, Records(name)) for name in FORMATS)
    for claim in (mean, largest):
        needed = f"{paper[claim] * least:.0f} to {paper[claim] * most:.0f} ms, an A6000 takes {A6000_MS:.1f} ms"
        verdict = f"not reproducible (needs a GPU frame of {needed})"
        rows.append({"claim": claim, "ours": A6000_MS / least, "paper": paper[claim], "verdict": verdict})
    return rows


def _time_line(frame: FrameTime, scene: str) -> Lanes:
    """The first fills of the buffers: forty stretches of step 1."""
    microsecond = frame.machine.clock_mhz
    step1 = [span for span in frame.spans if span.unit == "step1"]
    horizon = step1[min(40, len(step1)) - 1].end if step1 else frame.cycles
    identification = frame.units["identification"]
    lanes: dict[str, list[tuple[float, float]]] = {"identification": []}
    if identification.items:
        begin, end = identification.first_start, min(identification.last_end, horizon)
        lanes["identification"].append((begin / microsecond, (end - begin) / microsecond))
    for span in frame.spans:
        if span.begin < horizon:
            lanes.setdefault(span.unit, []).append((span.begin / microsecond, (span.end - span.begin) / microsecond))
    title = f"A frame's first {horizon / microsecond:.0f} µs: {scene}, {frame.machine.name}"
    return Lanes("accelerator_fig8", title, "time, µs; a stretch ends when its results are taken", lanes)


def _speed_ups(found: SpeedUp, machine: Machine) -> Plot:
    scenes = sorted(COUNTS, key=lambda scene: RATES[scene].exclusion)
    at = [100 * RATES[scene].exclusion for scene in scenes]
    theirs = jo2024.SPEED_UPS["clustering on the accelerator, mean"]
    curves = [
        Curve("by bytes, fp16", at, [_by_bytes(machine, scene) for scene in scenes]),
        Curve(f"simulated, {machine.records.format}", at, [found.of_scene[scene] for scene in scenes]),
        Curve("mean, theirs", [at[0], at[-1]], [theirs, theirs], theirs=True),
    ]
    return Plot("accelerator_fig9", "Speed-up of clustering, a point a scene", "excluded, %", "speed-up", curves)


def _by_bytes(machine: Machine, scene: str) -> float:
    fp16 = replace(machine, records=Records("fp16"))
    return compulsory_ms(fp16, scene, clustering=False) / compulsory_ms(fp16, scene, clustering=True)
