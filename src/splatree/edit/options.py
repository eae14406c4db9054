"""What may be done to a scene on its way from one file to another; the command line's help is these docstrings."""

from dataclasses import dataclass
from typing import Final, Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals

__all__ = ["EditOptions", "Order"]

Order = Literal["kept", "morton"]
"""Order of rows: as they come, or along a Z-curve, so that neighbours in the file are neighbours in space."""

_FARTHEST: Final = 1e100
"""Squares of these have room."""


@dataclass(frozen=True)
class EditOptions:
    """Edits of a scene, in the order in which they are done.

    Faint Gaussians are dropped. The others are scaled, turned and moved, and then cropped in their new place. Harmonics are cut,
    and rows are ordered last.

    Example:
        >>> st.EditOptions(crop_sphere=(0, 0, 0, 10)).may_drop_rows
        True
    """

    min_opacity: float = 0.0
    """Drop Gaussians whose opacity, 0 to 1, is less than this."""
    scale: float = 1.0
    """Multiply all lengths by this, about the origin."""
    rotate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Turn about the x axis, then y, then z, by these degrees, about the origin; harmonics turn with the scene."""
    translate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Move by this much along x, y and z, world units."""
    crop_box: tuple[float, float, float, float, float, float] | None = None
    """Keep Gaussians whose centre lies in this box: its smallest x y z, then its largest x y z."""
    crop_sphere: tuple[float, float, float, float] | None = None
    """Keep Gaussians whose centre lies within the sphere with this centre x y z and radius."""
    sh_degree: int = 3
    """Remove the harmonics above this degree."""
    order: Order = "kept"
    """Order of the rows: `kept`, or `morton`: neighbours in the file are then neighbours in space."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 0 <= self.min_opacity < 1:
            raise InputError(f"min_opacity: found {self.min_opacity}, wanted at least 0 and less than 1")
        if not 1e-12 <= self.scale <= 1e12:
            raise InputError(f"scale: found {self.scale}, wanted 1e-12 to 1e12")
        for name in ("rotate", "translate", "crop_box", "crop_sphere"):
            found, wanted = getattr(self, name), {"crop_box": 6, "crop_sphere": 4}.get(name, 3)
            if found is None and name.startswith("crop"):
                continue
            try:
                numbers = tuple(map(float, found))
            except (TypeError, ValueError) as error:
                raise InputError(f"{name}: found {found!r}, wanted {wanted} numbers") from error
            if len(numbers) != wanted:
                raise InputError(f"{name}: found {found}, wanted {wanted} numbers")
            if not all(abs(number) <= _FARTHEST for number in numbers):
                raise InputError(f"{name}: found {found}, wanted numbers of at most {_FARTHEST:g}")
            object.__setattr__(self, name, numbers)  # lists and arrays, too
        if self.crop_box is not None and any(
            low > high for low, high in zip(self.crop_box[:3], self.crop_box[3:], strict=True)
        ):
            raise InputError(f"crop_box: found {self.crop_box}, wanted the least x y z, then the largest")
        if self.crop_sphere is not None and self.crop_sphere[3] < 0:
            raise InputError(f"crop_sphere: found radius {self.crop_sphere[3]}, wanted 0 or more")
        if not 0 <= self.sh_degree <= 3:
            raise InputError(f"sh_degree: found {self.sh_degree}, wanted 0 to 3")

    @property
    def may_drop_rows(self) -> bool:
        """Whether a filter is set."""
        return self.min_opacity > 0 or self.crop_box is not None or self.crop_sphere is not None
