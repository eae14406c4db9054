"""Where a scene in training lies."""

from dataclasses import dataclass

from splatree.scene.origin import Origin

__all__ = ["World"]


@dataclass(frozen=True)
class World:
    """Where a scene lies, and how large it is."""

    extent: float
    """How far the cameras reach, world units."""
    near: float
    """Nearest depth that is drawn, world units."""
    origin: Origin
    """Where its zero lies in the world of the cameras."""
