"""Runs that may be interrupted: where their checkpoints are kept, and who interrupts them."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from splatree.errors import OutputError
from splatree.io.objects import ObjectPath
from splatree.train.checkpoint import CHECKPOINT, CommandName, check_folder, command_of


@dataclass(frozen=True)
class Run:
    """Where a run is kept, and whether it goes on."""

    run: Path | None = None
    """Folder for the checkpoint, and for the log and the exposures of a training; None: `scene.run` beside `scene.splatree`.
    --force replaces a run of the same kind there, never another's."""
    resume: bool = False
    """Go on from the checkpoint in the folder of the run, with the same options; the output is replaced."""

    def folder(self, output: Path, command: CommandName, *, force: bool) -> Path:
        """The folder of the run that makes an output, checked before any work is done.

        Raises:
            InputError: no run is there that could go on.
            OutputError: it cannot be made; or it holds a run already, of another command, or one which shall neither go on nor be
                replaced.
        """
        beside = Path(output.name) if isinstance(output, ObjectPath) else output
        folder = self.run or beside.with_name(f"{output.stem}.run")
        check_folder(folder, resume=self.resume)
        other = command_of(folder)
        if other is not None and other != command:
            raise OutputError(
                f"{folder}: holds a run of {other}, which {command} neither replaces nor goes on with; name another folder with "
                "--run"
            )
        if (folder / CHECKPOINT).exists() and not (self.resume or force):
            raise OutputError(
                f"{folder}: holds a run already; go on with --resume, replace it with --force, or name another with --run"
            )
        return folder


def goes_on(folder: Path) -> str:
    """What is said of a run that was interrupted."""
    return f"interrupted: the run goes on from {folder} with --resume"


@contextmanager
def interruptions() -> Iterator[Callable[[], bool]]:
    """Whether the user, or the system (SIGTERM), has interrupted the program; the second interruption ends it at once."""
    happened = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield happened.is_set
        return

    def notice(number: int, frame: FrameType | None) -> None:
        happened.set()
        for one, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
            signal.signal(one, handler)

    before = {number: signal.signal(number, notice) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield happened.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
