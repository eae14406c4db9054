"""``splatree train``: a scene from photographs."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, UsageError, counted, size, table
from splatree.cli.files import lost_and_noted, output_format
from splatree.cli.runs import Run, goes_on, interruptions
from splatree.errors import OutputError
from splatree.io.photos import PhotosUsed
from splatree.io.registry import stored_bytes
from splatree.io.replacing import check_target
from splatree.io.writing import write
from splatree.kernels.devices import DeviceName
from splatree.train.options import RunFiles, TrainOptions
from splatree.train.run import train
from splatree.train.state import Scored


@dataclass(frozen=True)
class Command:
    """Train a scene from photographs whose cameras are known: photographs/ -o scene.splatree --minutes 10.

    The first interruption (Ctrl-C, SIGTERM) ends the run with a whole scene and a checkpoint, from which --resume goes on.
    """

    photos: Positional[Path]
    """Folder of photographs, with a COLMAP model, transforms.json or cameras.json."""
    output: Annotated[Path | None, arg(aliases=["-o"])] = None
    """File to write."""
    force: bool = False
    """Replace the output, and the run beside it, if they exist."""
    cameras: Path | None = None
    """cameras.json, transforms.json or a COLMAP model; None: those in the folder of the photographs."""
    going_on: Annotated[Run, arg(name="", help="")] = Run()
    replay: Path | None = None
    """log.json of an earlier run: make its steps again instead of reading the clock."""
    device: DeviceName = "cpu"
    """Where steps are computed: `cpu`; `cuda`, an NVIDIA GPU; `reference`, the slow definitions to compare with."""
    threads: int = 0
    """Threads to use; 0: all. The scene is the same for any number, at equal steps."""
    options: Annotated[TrainOptions, arg(name="", help="")] = TrainOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was trained and written."""

    output: Path
    """The file."""
    run: Path
    """Folder with the checkpoint, the log and the exposures."""
    num_gaussians: int
    """Gaussians that were trained."""
    num_nodes: int
    """Gaussians and merged nodes in the file."""
    held_out: str
    """Which photographs were held out, and of how many."""
    history: tuple[Scored, ...]
    """Scores in the course of the run."""
    stopped: bool
    """Whether the run was interrupted."""
    bytes: int
    """Size of the file."""
    photographs: PhotosUsed
    """Which photographs were trained on."""
    lost: tuple[str, ...] = ()
    """What the file does not hold, a sentence each."""
    notes: tuple[str, ...] = ()
    """What was chosen or left out that the user should know, a sentence each."""


def run(command: Command) -> Result:
    """Train and write."""
    output = _output(command)
    folder = command.going_on.folder(output, "train", force=command.force)
    with interruptions() as interrupted:
        trained = train(
            command.photos,
            command.options,
            cameras=command.cameras,
            files=RunFiles(folder, command.going_on.resume, command.replay),
            stop=interrupted,
            watch=lambda scored: _tell(scored, command.console),
            device=command.device,
            threads=command.threads,
        )
    scene = trained.scene
    lost, notes = lost_and_noted(scene, write(scene, output, force=command.force or command.going_on.resume))
    return Result(
        output,
        folder,
        num_gaussians=scene.tree.num_leaves,
        num_nodes=len(scene),
        held_out=trained.rule,
        history=trained.history,
        stopped=trained.stopped,
        bytes=stored_bytes(output),
        photographs=trained.photographs,
        lost=lost,
        notes=(*trained.notes, *notes),
    )


def _output(command: Command) -> Path:
    """The file to write, checked before any work is done."""
    if command.output is None:
        raise UsageError("found no output, wanted a file to write: -o scene.splatree")
    check_target(command.output)
    output_format(command.output, keeps_tree=command.options.levels != "none")
    if command.output.exists() and not (command.force or command.going_on.resume):
        raise OutputError(f"{command.output}: exists already; choose another name or replace it with --force")
    return command.output


def _tell(scored: Scored, console: Console) -> None:
    """Say on stderr how far the run has come."""
    if console.quiet or sys.stderr is None or not (sys.stderr.isatty() or console.verbose):
        return
    score = scored.score
    quality = "" if score is None or score.psnr is None else f", held-out PSNR {score.psnr:.2f} dB"
    fitted = (
        "" if score is None or score.psnr_fitted is None else f" ({score.psnr_fitted:.2f} with the exposure fitted)"
    )
    print(
        f"{scored.share:.0%}: {scored.iterations:,} steps, {scored.num_gaussians:,} Gaussians, loss {scored.loss:.4f}"
        f"{quality}{fitted}",
        file=sys.stderr,
        flush=True,
    )


def show(result: Result) -> str:
    """The result in words."""
    rows = [_row(scored) for scored in result.history]
    nodes = "" if result.num_nodes == result.num_gaussians else f", {result.num_nodes:,} nodes"
    lines = [table(rows)] if rows else []
    lines.append(f"wrote {result.output}: {counted(result.num_gaussians, 'Gaussian')}{nodes}, {size(result.bytes)}")
    lines.append(f"held out: {result.held_out}")
    lines += result.photographs.in_words()
    lines += [f"note: {note}" for note in result.notes]
    lines += [f"lost: {sentence}" for sentence in result.lost]
    if result.stopped:
        lines.append(goes_on(result.run))
    return "\n".join(lines)


def _row(scored: Scored) -> dict[str, object]:
    row: dict[str, object] = {
        "done": f"{scored.share:.0%}",
        "CPU s": scored.cpu_s,
        "steps": scored.iterations,
        "Gaussians": scored.num_gaussians,
        "loss": scored.loss,
    }
    if scored.score is not None:
        row |= {"PSNR": scored.score.psnr, "fitted": scored.score.psnr_fitted, "SSIM": scored.score.ssim}
    return row
