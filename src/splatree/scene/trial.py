"""What a trial of both methods found on a sample of a scene: `render/trial.py` makes it, `LevelRecord` keeps it."""

from dataclasses import dataclass, fields

from splatree.errors import InputError
from splatree.scene.thinning import Method

__all__ = ["MethodTrial"]


@dataclass(frozen=True)
class MethodTrial:
    """How good cuts of both methods look, at equal nodes, on a sample of the scene.

    Example:
        >>> trial = st.MethodTrial(radius_db=27.4, pairs_db=30.1, num_gaussians=60_000, num_pictures=12)
        >>> trial.better
        'pairs'
    """

    radius_db: float
    """Mean PSNR of cuts by a radius against all leaves, dB."""
    pairs_db: float
    """Mean PSNR of cuts by pairs, in the same views and with as many nodes, dB."""
    num_gaussians: int
    """Gaussians of the sample."""
    num_pictures: int
    """Pictures that each mean is taken over; 0: no picture told the methods apart."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e12:
                raise InputError(f"MethodTrial.{field.name}: found {value!r}, wanted a finite number, 0 or more")

    @property
    def better(self) -> Method:
        """The method of the better pictures; `pairs` if both are equal, `radius` if no picture told them apart."""
        return "radius" if self.radius_db > self.pairs_db or not self.num_pictures else "pairs"

    def in_words(self) -> str:
        """Both figures, and where they are from."""
        if not self.num_pictures:
            return f"no picture of {self.num_gaussians:,} Gaussians told the methods apart"
        return (
            f"at equal nodes, pairs {self.pairs_db:.1f} dB, radius {self.radius_db:.1f} dB against all leaves "
            f"({self.num_pictures} pictures each of {self.num_gaussians:,} Gaussians)"
        )
