"""``splatree simulate``: what a frame of a scene costs on an accelerator, cycle by cycle."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, table
from splatree.cli.files import Reading, check_inputs, read_scene
from splatree.clusters.build import build_clusters
from splatree.errors import InputError, OutputError
from splatree.hardware.config import Machine
from splatree.hardware.paper import traces_of_table_i
from splatree.hardware.presets import changed, machine_from_toml, machine_to_toml, preset
from splatree.hardware.report import ablation_rows, frame_rows, page_of, summary_row, unit_rows
from splatree.hardware.study import ablation, draw_traces, on_machine
from splatree.hardware.trace import FrameTrace, read_trace, write_trace
from splatree.io.cameras.files import read_cameras
from splatree.io.replacing import check_free_in, replacing
from splatree.render.paths import PathOptions, flyout
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

_NAMES = ("index.html", "machine.toml")
"""Files of a report."""


@dataclass(frozen=True)
class Command:
    """Simulate an accelerator on a scene's frames: cycles, bytes, joules, area, and what bounds it.

    splatree simulate city.ply --cameras cameras.json -o report/
    splatree simulate --trace-from table1 --preset jo2024
    """

    paths: Positional[tuple[Path, ...]] = ()
    """The scene: files or folders; or .npz traces that --traces wrote."""
    cameras: Path | None = None
    """File or folder of cameras; without, a flight out of the scene."""
    views: int = 4
    """Views of the flight, or of the cameras that are drawn, evenly chosen."""
    pixel_error: float = 0.0
    """Radius up to which levels of detail are drawn, px, on a machine with selects_levels=true; 0: all leaves."""
    clusters: int = 8192
    """Clusters to make if the scene has none."""
    preset: str = "jo2024"
    """Machine to start from: jo2024, gscore-like, neo-like or splatree."""
    machine: Path | None = None
    """TOML file of a machine; fields that it leaves out are as in the preset that it names."""
    set: tuple[str, ...] = ()
    """Settings of the machine, such as dram.bandwidth_gbps=51.2 order=oracle."""
    sweep: str | None = None
    """A setting and its values, such as dram.bandwidth_gbps=12.8,25.6,51.2."""
    trace_from: Literal["table1"] | None = None
    """`table1`: frames with the exclusion rates of Jo 2024, Table I, instead of a scene."""
    traces: Path | None = None
    """Folder to write the frames' counts to, as .npz."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for the report: index.html and the machine as TOML."""
    force: bool = False
    """Replace files that are there."""
    reading: Annotated[Reading, arg(name="", help="")] = field(default_factory=Reading)
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was simulated."""

    machine: Machine
    """The machine."""
    mean: dict[str, object]
    """The mean frame."""
    frames: list[dict[str, object]]
    """Each frame."""
    engines: list[dict[str, object]]
    """What each engine did."""
    ablation: list[dict[str, object]]
    """The machine without each idea of the paper."""
    sweep: list[dict[str, object]]
    """The machine at each value of the swept setting."""
    energy: dict[str, float]
    """Millijoules of the mean frame by where they go."""
    written: tuple[Path, ...]
    """Files."""


def run(command: Command) -> Result:
    """Draw or read the frames, simulate, write the report."""
    if command.output is not None:
        check_free_in(command.output, _NAMES, force=command.force)
    if command.traces is not None:
        check_free_in(command.traces, ["frame_000.npz"], force=command.force)
    machine = _machine_of(command)
    swept = _sweep_of(command.sweep, machine) if command.sweep else None
    traces = _traces_of(command, machine)
    simulation = on_machine(machine, traces)
    ablations = list(ablation(machine, traces))
    sweep = (swept[0], [(value, on_machine(other, traces)) for value, other in swept[1]]) if swept else None
    written: list[Path] = []
    if command.traces is not None:
        _folder(command.traces)
        for i, one in enumerate(traces):
            written.append(command.traces / f"frame_{i:03}.npz")
            write_trace(one, written[-1], force=command.force)
    if command.output is not None:
        _folder(command.output)
        about = {"frames": f"{len(traces)} of {traces[0].num_rows:,} Gaussians", "from": _source_of(command)}
        page = page_of(simulation, ablations, sweep, about)
        for name, text in zip(_NAMES, (page, machine_to_toml(machine)), strict=True):
            written.append(command.output / name)
            with replacing(written[-1], force=command.force) as temporary:
                temporary.write_text(text, "utf-8")
    stacks = [energy.stack for energy in simulation.energies]
    return Result(
        machine=machine,
        mean=summary_row(machine.name, simulation),
        frames=frame_rows(simulation),
        engines=unit_rows(simulation),
        ablation=ablation_rows(ablations),
        sweep=[{sweep[0]: value} | summary_row(machine.name, one) for value, one in sweep[1]] if sweep else [],
        energy={name: float(np.mean([stack[name] for stack in stacks])) for name in stacks[0]},
        written=tuple(written),
    )


def show(result: Result) -> str:
    """The tables."""
    energy = ", ".join(f"{name} {value:.2f}" for name, value in result.energy.items())
    parts = [
        table([result.mean]),
        f"Frames\n{table(result.frames)}",
        f"Engines, shares of a frame\n{table(result.engines)}",
        f"What each idea is worth\n{table(result.ablation)}",
        f"Energy of the mean frame, mJ: {energy}",
    ]
    if result.sweep:
        parts.append(f"Sweep\n{table(result.sweep)}")
    if result.written:
        parts.append("wrote " + ", ".join(str(path) for path in result.written))
    return "\n\n".join(parts)


def _machine_of(command: Command) -> Machine:
    start = machine_from_toml(command.machine) if command.machine is not None else preset(command.preset)
    return changed(start, command.set)


def _traces_of(command: Command, machine: Machine) -> tuple[FrameTrace, ...]:
    if command.trace_from is not None:
        if command.paths:
            raise UsageError("simulate: found both a scene and --trace-from, wanted one of them")
        return tuple(traces_of_table_i().values())
    if not command.paths:
        raise UsageError("simulate: wanted a scene, traces (.npz), or --trace-from table1")
    check_inputs(command.paths)
    if all(path.suffix == ".npz" for path in command.paths):
        return _one_scene(command.paths)
    scene: Scene = read_scene(command.paths, command.reading)
    if scene.clusters is None:
        scene = build_clusters(scene, min(command.clusters, len(scene)))
    if command.views < 1:
        raise InputError(f"views: found {command.views}, wanted at least 1")
    views = (
        list(read_cameras(command.cameras))
        if command.cameras
        else list(flyout(scene, PathOptions(views=command.views)))
    )
    chosen = np.unique(np.linspace(0, len(views) - 1, min(command.views, len(views))).round().astype(int))
    return draw_traces(scene, [views[i] for i in chosen], machine, select=SelectOptions(command.pixel_error))


def _one_scene(paths: Sequence[Path]) -> tuple[FrameTrace, ...]:
    """Traces of files, which the orders learn from each other."""
    traces = tuple(read_trace(path) for path in paths)
    for path, trace in zip(paths, traces, strict=True):
        if not trace.is_of_scene_of(traces[0]):
            raise InputError(f"{path}: found a frame of another scene than {paths[0]}, wanted frames of one scene")
    return traces


def _sweep_of(sweep: str, machine: Machine) -> tuple[str, list[tuple[float, Machine]]]:
    """The setting that is swept, and the machine at each of its values."""
    name, separator, values = sweep.partition("=")
    if not separator or not values:
        raise UsageError(f"sweep: found {sweep!r}, wanted NAME=VALUE,VALUE,…")
    machines = []
    for value in values.split(","):
        other = changed(machine, [f"{name}={value}"])
        try:
            machines.append((float(value), other))
        except ValueError:
            raise UsageError(f"sweep: found the value {value!r}, wanted numbers; use --set for words") from None
    return name, machines


def _source_of(command: Command) -> str:
    return "rates of Jo 2024, Table I" if command.trace_from else ", ".join(str(path) for path in command.paths)


def _folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be made a folder: {error.strerror}") from error
