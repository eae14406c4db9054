"""How large a scene would be in other formats: an estimate from its rows and its degree.

Plain formats have a fixed number of bytes a row. Those of the compressed ones were measured on 120,000 Gaussians of the bundled
piece of a city (degrees 0 and 3), as the writers of this package wrote them. On two other scenes, of degrees 0 and 2, they err
by up to 15 %. All three scenes came from SOG, whose palettes of harmonics compress well. So an .spz, .sog or .rad of a scene
straight from training may be larger.
"""

from typing import Final

__all__ = ["estimated_bytes", "estimated_compact_bytes"]

BYTES_PER_ROW: Final = {
    ".ply": (68.0, 12.0, 3),
    ".compressed.ply": (16.3, 3.0, 3),
    ".splat": (32.0, 0.0, 0),
    ".ksplat": (24.4, 6.0, 2),
    ".glb": (60.0, 12.0, 3),
    ".spz": (16.6, 0.73, 3),
    ".sog": (12.9, 0.83, 3),
    ".rad": (18.6, 2.09, 3),
    ".splatree": (65.0, 12.0, 3),
}
"""Bytes of a Gaussian of degree 0; bytes of each harmonic (of three colours) beyond the DC; largest degree that the format holds.
Levels of detail are not counted."""

COMPACT_NODE = 8.0
"""Bytes of a merged node in a compact .splatree: 3 to 8, by how its levels were made."""


def estimated_compact_bytes(num_leaves: int, num_rows: int, sh_degree: int) -> int:
    """Estimated size of a compact .splatree with levels, bytes.

    Args:
        num_leaves: Gaussians.
        num_rows: Gaussians and merged nodes.
        sh_degree: degree of the harmonics, 0 to 3.

    Example:
        >>> from splatree.io.estimate import estimated_compact_bytes
        >>> estimated_compact_bytes(1_000_000, 1_500_000, 0)
        16900000
    """
    return estimated_bytes(num_leaves, sh_degree)[".sog"] + round(COMPACT_NODE * (num_rows - num_leaves))


def estimated_bytes(num_rows: int, sh_degree: int) -> dict[str, int]:
    """Estimated size of a flat scene in each format that is written, by suffix, bytes.

    Args:
        num_rows: Gaussians.
        sh_degree: degree of the harmonics, 0 to 3.

    Example:
        >>> from splatree.io.estimate import estimated_bytes
        >>> estimated_bytes(1_000_000, 3)[".ply"]
        248000000
    """
    return {
        suffix: round(num_rows * (plain + harmonic * ((min(sh_degree, degree) + 1) ** 2 - 1)))
        for suffix, (plain, harmonic, degree) in BYTES_PER_ROW.items()
    }
