"""The folder in which a build through files works, beside the one that it will be: what is done is marked there.

    city.splatree.work/
      lock                          which process works here (lock.py)
      plan.json                     what was decided for the whole scene
      slices/00000.splatree         rows of the input, by cell
      cells/00000.splatree          one cell along the curve, to degree 0; of roots of parts, .sh.npy: the harmonics above;
                                    where they follow the pixel, .drawn.splatree and .shown.npy: as they are drawn, and
                                    what leaves show
      sight/0.npy                   what is seen of each row of the input along one axis
      sight/seen.npy                what others leave to be seen of each row
      above/                        the work on the levels above: its cells are the roots of the parts
      thinned/00000.splatree .npy   what thinning leaves of one cell, and its rows of the input
      done/…json                    a mark for each piece of work that is done, with what came of it
      scene/                        the folder to be: parts, crown, manifest

Each file is written beside its place and renamed when it is whole; its mark comes after. So a build that was killed goes on with
the pieces that have no mark, and a piece may be done twice, even at the same time, with the same result.
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.io.memory import reserve
from splatree.io.objects import ObjectPath
from splatree.io.replacing import remove_abandoned, replacing
from splatree.outofcore.lock import LOCK
from splatree.shapes import Array

__all__ = ["Work"]

FOLDERS = ("slices", "cells", "sight", "thinned", "done", "scene/parts", "above/cells")


@dataclass(frozen=True)
class Work:
    """Where the pieces of one build are."""

    folder: Path
    """The folder of the build."""

    @staticmethod
    def beside(target: Path) -> "Work":
        """The folder beside a file or folder to be; of one in a store, in the working folder."""
        name = target.name + ".work"
        return Work((Path(name) if isinstance(target, ObjectPath) else target.with_name(name)).absolute())

    def begin(self) -> None:
        """Make the folders, and remove what killed processes left half-written, and the plan of a build that was done."""
        if self.plan.exists() and not self.scene.exists():  # it has taken its place
            self.plan.unlink()
        for name in FOLDERS:
            (self.folder / name).mkdir(parents=True, exist_ok=True)
            remove_abandoned(self.folder / name)

    def clear(self) -> None:
        """Remove all but the lock of the process that works here."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != LOCK:
                path.unlink(missing_ok=True)

    @property
    def plan(self) -> Path:
        """What was decided for the whole scene."""
        return self.folder / "plan.json"

    @property
    def above(self) -> "Work":
        """The work on the levels above the parts of this one, whose roots are its cells."""
        return Work(self.folder / "above")

    @property
    def token(self) -> Path:
        """Which of all folders this is: a worker that reads it sees the folder."""
        return self.folder / "token"

    @property
    def scene(self) -> Path:
        """The folder to be."""
        return self.folder / "scene"

    def slice(self, number: int) -> Path:
        """Rows of the input, by cell."""
        return self.folder / "slices" / f"{number:05}.splatree"

    def cell(self, number: int) -> Path:
        """The Gaussians of a cell to degree 0, along the curve; above parts, the roots of a part."""
        return self.folder / "cells" / f"{number:05}.splatree"

    def harmonics(self, number: int) -> Path:
        """The harmonics above degree 0 of a cell of roots; those of a cell of the input stay in the slices."""
        return self.folder / "cells" / f"{number:05}.sh.npy"

    def bounds(self, number: int) -> Path:
        """Boxes of runs of rows of a cell."""
        return self.folder / "cells" / f"{number:05}.bounds.npy"

    def drawn(self, number: int) -> Path:
        """The rows of a cell of roots as they are drawn, where they follow the pixel."""
        return self.folder / "cells" / f"{number:05}.drawn.splatree"

    def sight(self, axis: int) -> Path:
        """What is seen of each row of the input along an axis."""
        return self.folder / "sight" / f"{axis}.npy"

    @property
    def seen(self) -> Path:
        """What others leave to be seen of each row of the input."""
        return self.folder / "sight" / "seen.npy"

    def shown(self, number: int) -> Path:
        """What the leaves below the rows of a cell of roots show, where they follow the pixel (`Shown.columns`)."""
        return self.folder / "cells" / f"{number:05}.shown.npy"

    def thinned(self, number: int) -> Path:
        """What thinning leaves of a cell."""
        return self.folder / "thinned" / f"{number:05}.splatree"

    def thinned_rows(self, number: int) -> Path:
        """The row of the input that each Gaussian which thinning leaves of a cell stands for."""
        return self.folder / "thinned" / f"{number:05}.npy"

    def part_name(self, number: int) -> str:
        """The part of a cell, in the folder to be."""
        return f"parts/{number:05}.splatree"

    def result(self, piece: str, run: str) -> dict[str, Any] | None:
        """What came of a piece of work of a run; None: it is not done."""
        path = self.folder / "done" / f"{piece}.json"
        if not path.exists():
            return None
        try:
            mark = json.loads(path.read_text("utf-8"))
        except ValueError:
            return None  # of another program: the piece is done again
        return mark["result"] if isinstance(mark, dict) and mark.get("run") == run else None

    def finish(self, piece: str, run: str, result: dict[str, Any]) -> None:
        """Mark a piece of work as done; its files are in their places."""
        write_text(self.folder / "done" / f"{piece}.json", json.dumps({"run": run, "result": result}))


def write_text(path: Path, text: str) -> None:
    """Write a small file, whole or not at all."""
    with replacing(path, force=True) as temporary:
        temporary.write_text(text, "utf-8")


def write_array(path: Path, array: Array) -> None:
    """Write an array, whole or not at all."""
    with replacing(path, force=True) as temporary, temporary.open("wb") as file:
        np.save(file, array)


def read_array(path: Path) -> Array:
    """Map an array that `write_array` wrote."""
    try:
        array: Array = np.load(path, mmap_mode="r" if path.stat().st_size > 1 << 16 else None)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); delete the folder of work and build again") from error
    return array


def new_array(path: Path, num_rows: int, dtype: "np.dtype[Any]") -> "np.memmap[Any, Any]":
    """A mapped file of zeros, for which the disk has room."""
    array: np.memmap[Any, Any] = np.lib.format.open_memmap(path, "w+", dtype, (num_rows,))
    with path.open("r+b") as file:
        file.seek(array.offset)  # behind the head
        reserve(file, array.nbytes)
    return array
