"""The files that a verb draws: their names, whether they may be written, and old ones that are taken away."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from splatree.errors import OutputError
from splatree.io.images import is_ours, write_image, write_plane
from splatree.io.replacing import check_target
from splatree.render.moving import MovedFrame
from splatree.scene.cameras import Camera
from splatree.scene.frame import RenderResult

__all__ = ["PlaneSuffix", "Targets", "file_names", "refuse_existing", "remove_stale"]

PlaneSuffix = Literal["png", "exr"]
"""Format of depth and alpha."""


@dataclass(frozen=True)
class Targets:
    """Where the pictures of one view go."""

    picture: Path | None
    """The picture; None if none is asked for."""
    depth: Path | None = None
    """Its depth."""
    alpha: Path | None = None
    """Its alpha."""
    counters: Path | None = None
    """The work of each cluster and tile."""

    @property
    def paths(self) -> tuple[Path, ...]:
        """All of them."""
        return tuple(path for path in (self.picture, self.depth, self.alpha, self.counters) if path is not None)

    def write(self, result: RenderResult | MovedFrame, *, force: bool) -> None:
        """Write picture, depth and alpha."""
        if self.picture is not None:
            write_image(result.image, self.picture, force=force)
        if self.depth is not None and isinstance(result, RenderResult):
            write_plane(result.depth, self.depth, channel="Z", force=force)
        if self.alpha is not None:
            write_plane(result.alpha, self.alpha, channel="A", force=force)


def file_names(cameras: Iterable[Camera]) -> list[str]:
    """A file name for each view: its camera's name without folders and suffix, or its number where that is not unique."""
    stems = [re.sub(r"[^\w.-]+", "_", Path(camera.name).stem) for camera in cameras]
    counts = Counter(stems)
    return [stem if stem and counts[stem] == 1 else f"{i:04d}" for i, stem in enumerate(stems)]


def targets_of(
    names: Sequence[str],
    output: Path | None,
    counters: Path | None,
    *,
    depth: PlaneSuffix | None,
    alpha: PlaneSuffix | None,
) -> list[Targets]:
    """Files of each view: in the folder ``output``, or ``output`` itself if it is a picture."""
    targets = []
    for name in names:
        picture = output if output is None or is_picture(output) else output / f"{name}.png"
        beside = [
            picture and suffix and picture.with_name(f"{picture.stem}_{kind}.{suffix}")
            for kind, suffix in (("depth", depth), ("alpha", alpha))
        ]
        targets.append(Targets(picture, beside[0] or None, beside[1] or None, counters and counters / f"{name}.npz"))
    return targets


def is_picture(path: Path) -> bool:
    """Whether a path names a picture, not a folder."""
    return path.suffix.lower() == ".png" and not path.is_dir()


def refuse_existing(paths: Iterable[Path], *, force: bool) -> None:
    """Refuse files that are there, unless they may be replaced, and places where no file can be.

    Raises:
        OutputError: the first of them, before anything is drawn.
    """
    for path in paths:
        check_target(path)
        if path.exists() and not force:
            raise OutputError(f"{path}: exists already; choose another name or folder, or use --force")


def remove_stale(folder: Path, written: Iterable[Path]) -> int:
    """Remove the pictures of an earlier run from a folder; return how many. Pictures of other programs stay."""
    kept = set(written)
    stale = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in (".png", ".exr") and path not in kept and path.is_file() and is_ours(path)
    ]
    for path in stale:
        path.unlink()
    return len(stale)


def make_folder(folder: Path) -> None:
    """Make a folder, if it is not there.

    Raises:
        OutputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder ({error.strerror})") from error
