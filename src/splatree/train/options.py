"""How a scene is trained: defaults live here alone; the command line's help is these docstrings."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode

__all__ = ["DIVISIONS", "Alpha", "Exposure", "Levels", "RunFiles", "Size", "TrainOptions", "plain"]

Size = Literal["1", "1/2", "1/4", "1/8"]
"""Sizes at which photographs are compared, as shares of their own."""

DIVISIONS: dict[Size, int] = {"1": 1, "1/2": 2, "1/4": 4, "1/8": 8}
"""Photographs are divided by whole numbers, so that each pixel is the mean of whole pixels."""

Exposure = Literal["gain", "affine", "none"]
"""What of a photograph's exposure is told apart from the scene: a gain for each channel, a matrix, or nothing."""

Alpha = Literal["mask", "match"]
"""What the alpha channel of a photograph says: which pixels count, or where the object is."""

Levels = Literal["none", "radius", "pairs", "grow"]
"""Levels of detail of a trained scene: `none`; by `radius` or by `pairs`, built over it as `build` does; or a tree that grows in
training (`grow`), as FilterGS and LoG make theirs."""


@dataclass(frozen=True)
class TrainOptions:
    """How a scene is trained from photographs.

    Example:
        >>> options = st.TrainOptions(iterations=2, max_gaussians=500)
        >>> options.minutes is None, options.degree
        (True, 1)
    """

    minutes: float | None = None
    """Processor minutes, of all threads together, to train for; 10 if neither minutes nor iterations are given."""
    iterations: int | None = None
    """Steps to make instead, one photograph each: the result then does not depend on how fast the machine is."""
    max_gaussians: int = 200_000
    """Gaussians of the finished scene at most; training starts from the points of the cameras and divides what is wrong."""
    size: Size | None = None
    """Largest size that photographs are compared at; None: the largest at which they are at most 1,000 px long. Training begins
    with smaller ones."""
    degree: int = 1
    """Degree of the harmonics, 0 to 3: how much a colour may depend on the direction it is seen from."""
    mode: Mode = "classic"
    """How the scene is drawn, in training and ever after."""
    held_out: int | Path = 8
    """Photographs kept for scores, which training never sees: each n-th from the first, or those named in a file."""
    masks: Path | None = None
    """Folder of masks by the names of the photographs: pixels that are black in a mask are ignored. None: no masks."""
    exposure: Exposure = "gain"
    """`gain`: each photograph may be brighter or darker than the others, by a factor for each channel; `affine`: or have another
    white balance and haze, by a matrix of 3 × 4; `none`: all are equal."""
    alpha: Alpha = "mask"
    """What the alpha channel of a photograph means. `mask`: pixels that are not opaque are ignored; `match`: the scene is an
    object before nothing, and learns to be as transparent."""
    levels: Levels = "none"
    """Levels of detail: `none`, all Gaussians are leaves; `radius`, `pairs`: merged after training, as `splatree build` does;
    `grow`: in training a Gaussian that is too coarse gets four children and stays as it is (FilterGS)."""
    score: bool = True
    """Score the held-out photographs at 10, 25, 50, 75 and 100 % of the run. This takes none of the minutes."""
    seed: int = 0
    """Of the random numbers: the order of photographs, and which Gaussians are divided."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.minutes is not None and self.iterations is not None:
            raise InputError(f"minutes, iterations: found {self.minutes} and {self.iterations}, wanted one of them")
        if self.minutes is not None and not 0 < self.minutes <= 1e6:
            raise InputError(f"minutes: found {self.minutes}, wanted more than 0")
        if self.iterations is not None and not 1 <= self.iterations <= 10**9:
            raise InputError(f"iterations: found {self.iterations}, wanted 1 or more")
        if not 1 <= self.max_gaussians <= 2**31 - 1:
            raise InputError(f"max_gaussians: found {self.max_gaussians}, wanted at least 1")
        if not 0 <= self.degree <= 3:
            raise InputError(f"degree: found {self.degree}, wanted 0 to 3")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"seed: found {self.seed}, wanted 0 or more")
        if isinstance(self.held_out, int) and self.held_out < 2:
            raise InputError(
                f"held_out: found {self.held_out}, which leaves no photograph to train on; wanted 2 or more, or a file of names"
            )

    @property
    def budget_s(self) -> float | None:
        """Processor seconds to train for; None: iterations are counted instead."""
        return None if self.iterations is not None else 60 * (10.0 if self.minutes is None else self.minutes)


@dataclass(frozen=True)
class RunFiles:
    """Where a run is kept, so that it can go on or be repeated.

    Example:
        >>> from pathlib import Path
        >>> options = st.TrainOptions(iterations=2, max_gaussians=100)
        >>> first = st.train("photographs", options, files=st.RunFiles(Path("city.run")))
        >>> again = st.train("photographs", options, files=st.RunFiles(Path("city.run"), resume=True))
        >>> bool((first.scene.gaussians.means == again.scene.gaussians.means).all())
        True
    """

    folder: Path | None = None
    """Folder for the checkpoint, and for the log and the exposures of a training; it is made. None: nothing is kept."""
    resume: bool = False
    """Go on from the checkpoint in the folder, with the same options, and the same photographs or scene."""
    replay: Path | None = None
    """log.json of an earlier training: make its steps again instead of reading the clock."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.resume and self.folder is None:
            raise InputError("resume: found no folder of a run, wanted one with a checkpoint")


def plain(options: TrainOptions) -> dict[str, Any]:
    """Options as what JSON has."""
    return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(options).items()}
