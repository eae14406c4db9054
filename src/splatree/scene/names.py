"""Names of rules that several structs share: how a scene is drawn, and how large a node of its tree counts in a view."""

from collections.abc import Container
from typing import Final, Literal

Mode = Literal["classic", "antialiased"]
"""How a scene was trained and is drawn: `classic` adds 0.3 px² to each splat (Kerbl 2023); `antialiased` also lowers its
opacity so that its mass is kept (Yu 2024, Mip-Splatting, Eq. 9 without the 3D filter, as in gsplat)."""

Profile = Literal["exact", "3dgs", "ref", "sphere", "pixel"]
"""Named radius functions R(node, camera) in px."""

EXTENT_PROFILES: Final[Container[str]] = ("sphere", "pixel")
"""Profiles that decide by the extents of nodes alone."""
