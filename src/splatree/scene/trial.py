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
    radius_loss_db: float | None = None
    """By how much the cut by a radius is worse than that by pairs in the picture where it loses most, dB; negative: it is better
    in each. None: a file from before this was kept."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, least = getattr(self, field.name), 0.0
            if field.name == "radius_loss_db":
                if value is None:
                    continue
                least = -1e3
            if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < 1e12:
                raise InputError(
                    f"MethodTrial.{field.name}: found {value!r}, wanted a finite number, {least:g} or more"
                )

    @property
    def better(self) -> Method:
        """The method of the better pictures; `pairs` if both are equal, `radius` if no picture told them apart."""
        return "radius" if self.radius_db > self.pairs_db or not self.num_pictures else "pairs"

    def in_words(self) -> str:
        """Both figures, and where they are from."""
        if not self.num_pictures:
            return f"no picture of {self.num_gaussians:,} Gaussians told the methods apart"
        loss = self.radius_loss_db or 0.0
        worst = f" (in one picture {loss:.1f} dB less)" if loss > 0 else ""
        return (
            f"at equal nodes, pairs {self.pairs_db:.1f} dB, radius {self.radius_db:.1f} dB{worst} against all leaves "
            f"({self.num_pictures} pictures each of {self.num_gaussians:,} Gaussians)"
        )
