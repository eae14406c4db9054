"""The report of a simulation: rows for tables, and a page with plots that opens without a network."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from splatree.hardware.plots import bars, curves, time_line
from splatree.hardware.presets import machine_to_toml
from splatree.hardware.study import Simulation

__all__ = ["ablation_rows", "frame_rows", "page_of", "summary_row", "unit_rows"]

Row = dict[str, object]


def summary_row(name: str, simulation: Simulation) -> Row:
    """One line of a table: the mean frame of a simulation."""
    frames = simulation.frames
    return {
        "machine": name,
        "excluded %": 100 * simulation.exclusion,
        "front end ms": simulation.front_milliseconds,
        "frame ms": simulation.milliseconds,
        "FPS": simulation.fps,
        "MB a frame": float(np.mean([frame.total_bytes for frame in frames])) / 1e6,
        "mJ a frame": simulation.millijoules,
        "mm2": simulation.area.mm2,
        "bound by": frames[0].bounds.named,
    }


def ablation_rows(simulations: Sequence[tuple[str, Simulation]]) -> list[Row]:
    """The first simulation and the others, with their speed against the first."""
    first = simulations[0][1].milliseconds
    return [
        summary_row(name, simulation) | {"speed against the first": first / simulation.milliseconds}
        for name, simulation in simulations
    ]


def frame_rows(simulation: Simulation) -> list[Row]:
    """One line a frame: time, its least time by the bounds, what bounds it, first work of steps 1 and 2."""
    clock = simulation.machine.clock_mhz * 1e3
    return [
        {
            "frame": i,
            "frame ms": frame.milliseconds,
            "front end ms": frame.front_milliseconds,
            "front end bound ms": frame.bounds.front / clock,
            "bound by": frame.bounds.named,
            "rows walked": frame.num_walked,
            "Gaussians read": frame.num_rows,
            "survivors": frame.num_survivors,
            "pairs": frame.num_pairs,
            "row hits %": 100 * frame.row_hit_rate,
            "cache hits %": 100 * frame.cache_hit_rate,
            "step 1 starts us": frame.units["step1"].first_start / clock * 1e3,
            "step 2 starts us": frame.units["step2"].first_start / clock * 1e3,
        }
        for i, frame in enumerate(simulation.frames)
    ]


def unit_rows(simulation: Simulation) -> list[Row]:
    """One line an engine: the share of the mean frame in which it was busy, waited or had nothing to do."""
    rows: list[Row] = []
    for name in simulation.frames[0].units:
        units = [frame.units[name] for frame in simulation.frames]
        states = ("busy", "stalled_on_input", "stalled_on_output", "idle")
        sums = {state: float(sum(getattr(unit, state) for unit in units)) for state in states}
        total = sum(frame.cycles for frame in simulation.frames) or 1
        shares = {f"{state.replace('_', ' ')} %": 100 * value / total for state, value in sums.items()}
        rows.append({"engine": name, **shares, "items": sum(unit.items for unit in units)})
    return rows


def page_of(
    simulation: Simulation,
    ablations: Sequence[tuple[str, Simulation]],
    sweep: tuple[str, Sequence[tuple[float, Simulation]]] | None = None,
    about: Mapping[str, str] | None = None,
) -> str:
    """The report as a page of HTML.

    Args:
        simulation: the machine on the frames.
        ablations: the machine and what is left of it without each idea, by name.
        sweep: name of a setting that was swept, and the simulation at each of its values.
        about: what a reader needs to run it again.
    """
    first = simulation.frames[0]
    horizon = max(
        1, min(first.cycles, 40 * max((s.end - s.begin for s in first.spans if s.unit == "step1"), default=1))
    )
    parts = [
        ("The mean frame", _table([summary_row(simulation.machine.name, simulation)])),
        ("Frames", _table(frame_rows(simulation))),
        ("Time line of the first frame", time_line([s for s in first.spans if s.begin < horizon], horizon)),
        ("What each engine did", bars(_unit_bars(simulation), "ms") + _table(unit_rows(simulation))),
        ("Bytes between chip and DRAM", bars(_byte_bars(simulation), "MB")),
        ("Energy", bars({"mean frame": _energy_stack(simulation)}, "mJ")),
        ("Area and power of the chip", _table([vars(block) for block in simulation.area.blocks])),
        ("What each idea is worth", _table(ablation_rows(ablations))),
        ("Roofline of step 1", _roofline(simulation)),
    ]
    if sweep is not None:
        name, found = sweep
        values = [value for value, _ in found]
        lines = {
            "frame": (values, [one.milliseconds for _, one in found]),
            "front end": (values, [one.front_milliseconds for _, one in found]),
        }
        parts.append((f"Sweep of {name}", curves(lines, name, "ms")))
    parts.append(("The machine", f"<pre>{escape(machine_to_toml(simulation.machine))}</pre>"))
    head = "".join(f"<p><b>{escape(key)}</b>: {escape(value)}</p>" for key, value in (about or {}).items())
    body = "".join(f"<h2>{escape(title)}</h2>{content}" for title, content in parts)
    return PAGE.format(name=escape(simulation.machine.name), head=head, body=body)


def _unit_bars(simulation: Simulation) -> dict[str, dict[str, float]]:
    clock = simulation.machine.clock_mhz * 1e3 * len(simulation.frames)
    states = ("busy", "stalled_on_input", "stalled_on_output")
    return {
        name: {s.replace("_", " "): sum(getattr(f.units[name], s) for f in simulation.frames) / clock for s in states}
        for name in simulation.frames[0].units
    }


def _byte_bars(simulation: Simulation) -> dict[str, dict[str, float]]:
    return {f"frame {i}": {k: v / 1e6 for k, v in f.bytes.items()} for i, f in enumerate(simulation.frames[:12])}


def _energy_stack(simulation: Simulation) -> dict[str, float]:
    stacks = [energy.stack for energy in simulation.energies]
    return {name: float(np.mean([stack[name] for stack in stacks])) for name in stacks[0]}


def _roofline(simulation: Simulation) -> str:
    """Gaussians a cycle against Gaussians a byte: the bandwidth's slope, the lanes' roof, and each frame."""
    width, lanes = simulation.machine.bytes_per_cycle, simulation.machine.step1.lanes
    rates = [(f.num_rows / max(f.total_bytes, 1), f.num_rows / max(f.front_cycles, 1)) for f in simulation.frames]
    ridge = lanes / width
    least = min([ridge, *(x for x, _ in rates if x > 0)]) / 2
    roof = ([least, ridge, 4 * ridge], [least * width, lanes, lanes])
    dots = ([max(x, least) for x, _ in rates], [max(y, least * width) for _, y in rates])
    lines = {"roof": roof, "frames": dots}
    return curves(lines, "Gaussians of step 1 a byte", "Gaussians a cycle", log=True, points=("frames",))


def _table(rows: Sequence[Mapping[str, object]]) -> str:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    lines = "".join("<tr>" + "".join(f"<td>{_cell(row.get(c))}</td>" for c in columns) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{lines}</table></div>'


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.3f}" if abs(value) < 100 else f"{value:,.0f}"
    if isinstance(value, int):
        return f"{value:,}"
    return escape(str(value))


PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>splatree simulate: {name}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 2rem auto; padding: 0 1rem; }}
svg text {{ font: 12px system-ui, sans-serif; fill: currentColor; }}
table {{ border-collapse: collapse; font-size: 13px; }} td, th {{ padding: 3px 9px; text-align: right; }}
td:first-child, th:first-child {{ text-align: left; }} tr:nth-child(even) {{ background: #8881; }}
.scroll {{ overflow-x: auto; }} pre {{ font-size: 12px; columns: 2; }} h2 {{ margin-top: 2rem; }}
</style><h1>{name}, cycle by cycle</h1>{head}{body}</html>
"""
