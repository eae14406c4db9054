"""``splatree refine``: inner nodes learn what the leaves below them look like."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from splatree.cli.console import Console, counted, size
from splatree.cli.files import Files, inputs_and_output, lost_and_noted, read_scene, repairs_of, told
from splatree.cli.runs import Run, goes_on, interruptions
from splatree.errors import InputError
from splatree.io.cameras.files import read_cameras
from splatree.io.registry import stored_bytes
from splatree.io.writing import write
from splatree.kernels.devices import DeviceName
from splatree.render.overlap import overlap_hint
from splatree.scene.cameras import Camera
from splatree.train.checkpoint import remove
from splatree.train.options import RunFiles
from splatree.train.refine import refine
from splatree.train.refine_options import RefineOptions


@dataclass(frozen=True)
class Command:
    """Let the merged nodes of a tree learn from pictures of its own leaves: in.splatree out.splatree.

    No photographs are needed. Leaves and the tree stay as they are; only pictures from afar get better. The first interruption
    (Ctrl-C, SIGTERM) ends the run with a whole scene and a checkpoint, from which --resume goes on.
    """

    files: Annotated[Files, arg(name="", help="")]
    cameras: Path | None = None
    """Learn from these views: cameras.json, transforms.json or a COLMAP model; for a room or a street, which is seen from within.
    None: views are made all round the scene."""
    going_on: Annotated[Run, arg(name="", help="")] = Run()
    device: DeviceName = "cpu"
    """Where steps are computed: `cpu`; `cuda`, an NVIDIA GPU; `reference`, the slow definitions to compare with."""
    options: Annotated[RefineOptions, arg(name="", help="")] = RefineOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was gained and written."""

    output: Path
    """The file."""
    run: Path
    """Folder of the checkpoint; it is removed when the run has ended."""
    stopped: bool
    """Whether the run was interrupted."""
    iterations: int
    """Steps made."""
    before_db: float
    """Mean PSNR of the cut against all leaves, in views that were kept to judge by, dB, before."""
    after_db: float
    """The same afterwards."""
    worst_gain_db: float
    """The least that one of these views gained, dB."""
    judges: int
    """Number of these views."""
    num_learned: int
    """Inner nodes that changed."""
    num_inner: int
    """Inner nodes."""
    cpu_seconds: float
    """Processor time."""
    bytes: int
    """Size of the file."""
    repairs: dict[str, int]
    """How many values or rows each rule of repair touched."""
    lost: tuple[str, ...]
    """What the file does not hold, a sentence each."""
    notes: tuple[str, ...]
    """What reading and learning did that the user should know, a sentence each."""


def run(command: Command) -> Result:
    """Read, learn, write.

    Raises:
        InputError: the scene has no levels, or its pictures became no better: then nothing is written.
    """
    files, going_on = replace(command.files, force=command.files.force or command.going_on.resume), command.going_on
    inputs, output = inputs_and_output(files, keeps_tree=True)
    folder = going_on.folder(output, "refine", force=files.force)
    scene = read_scene(inputs, files.reading)
    cameras: tuple[Camera, ...] | None = None
    seen: tuple[str, ...] = ()
    if command.cameras is not None:
        found = read_cameras(command.cameras).relative_to(scene.source)
        cameras, hint = found.views, overlap_hint(scene, found.views)
        seen = (*found.notes, *([hint] if hint else []))
    with interruptions() as interrupted:
        refined = refine(
            scene,
            command.options,
            cameras=cameras,
            files=RunFiles(folder, going_on.resume),
            stop=interrupted,
            device=command.device,
        )
    if refined.num_learned:
        lost = write(refined.scene, output, force=files.force)
    if not refined.stopped:
        remove(folder)
    if not refined.num_learned:
        then = "give it more --minutes, or --cameras from where the scene is seen"
        raise InputError(
            f"refine: pictures became no better in {refined.iterations:,} steps ({refined.before.mean():.2f} dB), so nothing was "
            f"written; {goes_on(folder) if refined.stopped else then}"
        )
    lost, notes = lost_and_noted(refined.scene, lost)
    return Result(
        output=output,
        run=folder,
        stopped=refined.stopped,
        iterations=refined.iterations,
        before_db=float(refined.before.mean()),
        after_db=float(refined.after.mean()),
        worst_gain_db=float((refined.after - refined.before).min()),
        judges=len(refined.before),
        num_learned=refined.num_learned,
        num_inner=refined.num_nodes,
        cpu_seconds=refined.cpu_seconds,
        bytes=stored_bytes(output),
        repairs=repairs_of(scene),
        lost=lost,
        notes=(*notes, *seen, *refined.notes),
    )


def show(result: Result) -> str:
    """The result in words."""
    gained = (
        f"{result.judges} views kept to judge by: {result.before_db:.2f} to {result.after_db:.2f} dB in the mean, the least "
        f"{result.worst_gain_db:+z.2f} dB"
    )
    wrote = (
        f"wrote {result.output}: {result.num_learned:,} of {result.num_inner:,} merged nodes learned, "
        f"{counted(result.iterations, 'step')}, {result.cpu_seconds:.0f} s of processor time, {size(result.bytes)}"
    )
    interrupted = [goes_on(result.run)] if result.stopped else []
    return "\n".join([gained, wrote, *told(result.repairs, result.lost, result.notes), *interrupted])
