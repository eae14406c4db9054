"""A scene on a machine: draw its frames, simulate each, and set cycles, bytes, joules and square millimetres side by side."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatree.errors import InputError
from splatree.hardware.area import Area, area_of
from splatree.hardware.config import Machine
from splatree.hardware.energy import Energy, energy_of
from splatree.hardware.presets import preset
from splatree.hardware.simulate import FrameTime, simulate_frame
from splatree.hardware.trace import FrameTrace, trace_frame
from splatree.progress import track
from splatree.render.session import open_session
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted

__all__ = ["Simulation", "ablation", "draw_traces", "on_machine", "simulate"]


@dataclass(frozen=True)
class Simulation:
    """Frames of one scene on one machine.

    Example:
        >>> found = st.simulate(scene, cameras)
        >>> len(found.frames) == len(found.energies) == len(cameras)
        True
    """

    machine: Machine
    """The machine."""
    frames: tuple[FrameTime, ...]
    """Each frame, in the order of the cameras."""
    energies: tuple[Energy, ...]
    """What each takes."""
    area: Area
    """What the machine takes on the chip."""
    exclusion: float
    """Mean share of the Gaussians that identification leaves out; 0 without clusters."""
    ideal_exclusion: float
    """Mean share of the Gaussians that do not survive step 1."""

    @property
    def milliseconds(self) -> float:
        """Mean time of a frame."""
        return float(np.mean([frame.milliseconds for frame in self.frames]))

    @property
    def front_milliseconds(self) -> float:
        """Mean time of the front end of a frame."""
        return float(np.mean([frame.front_milliseconds for frame in self.frames]))

    @property
    def fps(self) -> float:
        """Frames over the sum of their times."""
        return 1e3 / self.milliseconds

    @property
    def millijoules(self) -> float:
        """Mean energy of a frame."""
        return float(np.mean([energy.total for energy in self.energies]))


@checked
def simulate(
    scene: Scene, cameras: Iterable[Camera], machine: Machine | str = "jo2024", *, select: SelectOptions | None = None
) -> Simulation:
    """Draw a scene's frames and run each on an accelerator, cycle by cycle.

    Args:
        scene: a scene with clusters (`build_clusters`).
        cameras: the views, in the order in which they are seen.
        machine: a `Machine`, or the name of a preset: `jo2024`, `gscore-like`, `neo-like`, `splatree`.
        select: nodes of the tree that are drawn; None: all leaves.

    Returns:
        Cycles, bytes, energy and area; see `Simulation`.

    Raises:
        InputError: the scene has no clusters, there are no cameras, or the machine's name is unknown.

    Source:
        Jo 2024, §4; docs/explanation/accelerator.md.

    Example:
        >>> scene = st.build_clusters(scene, 16)
        >>> st.simulate(scene, [camera]).fps > 0
        True
    """
    chosen = preset(machine) if isinstance(machine, str) else machine
    return on_machine(chosen, draw_traces(scene, cameras, chosen, select=select))


def draw_traces(
    scene: Scene, cameras: Iterable[Camera], machine: Machine, *, select: SelectOptions | None = None
) -> tuple[FrameTrace, ...]:
    """Draw the views with the machine's rule of identification, and count."""
    chosen = select or SelectOptions(pixel_error=0.0)
    rule = machine.identification.rule
    chosen = replace(chosen, cull="paper" if rule == "paper" else "exact")
    views = list(cameras)
    if not views:
        raise InputError("simulate: found no cameras, wanted at least one")
    wanted = Wanted(last_pair=True)  # so that entries are counted up to the one that finishes each pixel
    with open_session(scene, select=chosen) as session:
        return tuple(
            trace_frame(scene, session.trace(view, wanted), boxes=rule == "boxes")
            for view in track(views, "draw frames")
        )


def on_machine(machine: Machine, traces: Sequence[FrameTrace]) -> Simulation:
    """Run traces that are there already on a machine."""
    if not traces:
        raise InputError("simulate: found no traces, wanted at least one")
    frames = [simulate_frame(machine, traces, i) for i in range(len(traces))]
    blended = [int(one.tile_blended.sum()) for one in traces]
    return Simulation(
        machine=machine,
        frames=tuple(frames),
        energies=tuple(energy_of(time, count) for time, count in zip(frames, blended, strict=True)),
        area=area_of(machine),
        exclusion=float(np.mean([one.exclusion for one in traces])) if machine.clustering else 0.0,
        ideal_exclusion=float(np.mean([one.ideal_exclusion for one in traces])),
    )


def ablation(machine: Machine, traces: Sequence[FrameTrace]) -> Iterator[tuple[str, Simulation]]:
    """The machine with each idea of the paper taken away or exchanged, by name, the machine itself first."""
    yield "as given", on_machine(machine, traces)
    yield "no clusters", on_machine(replace(machine, clustering=False), traces)
    yield "single buffers", on_machine(replace(machine, ping_pong=False), traces)
    for order in ("oracle", "frequency", "previous-frame", "two-level", "morton", "index", "adversarial"):
        yield f"order {order}", on_machine(replace(machine, order=order), traces)
    for interval in (4, 16):
        slower = replace(machine.identification, interval=interval)
        yield f"a cluster every {interval} cycles", on_machine(replace(machine, identification=slower), traces)
    for skips in (True, False):
        for overlaps in (False, True):
            back = replace(machine.back, skips_subtiles=skips, overlaps=overlaps)
            name = f"subtiles {'skipped' if skips else 'evaluated'}, frames {'overlap' if overlaps else 'in turn'}"
            yield name, on_machine(replace(machine, back=back), traces)
