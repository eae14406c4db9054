"""The versions of .spz that are written, and what is known of the programs that read them.

Sources: the issues and pull requests of the programs: mrdoob/three.js #34187 and #34222, sparkjsdev/spark #171,
mkkellogg/GaussianSplats3D #467, playcanvas/splat-transform #226.
"""

from typing import Final

__all__ = ["DEFAULT_VERSION", "VERSIONS", "readers_of"]

DEFAULT_VERSION: Final = 4

VERSIONS: Final = {
    2: "every reader of .spz known to us takes it, but its rotations are off by up to 12 degrees",
    3: "readers of version 2 alone do not take it: GaussianSplats3D, Spark before October 2025",
    4: "Spark 2, splat-transform and SuperSplat read it; programs that expect gzip do not: three.js before August 2026, "
    "GaussianSplats3D",
}
"""Who can read each version that is written, and who cannot."""


def readers_of(version: int) -> str:
    """A sentence on a version: who can read it, and how to write another one.

    Args:
        version: 2, 3 or 4.

    Example:
        >>> from splatree.io.formats.spz.versions import readers_of
        >>> readers_of(3)[:13]
        'spz version 3'
    """
    older = {4: "; --spz-version 3 or 2 writes for older ones", 3: "; --spz-version 2 writes for them"}.get(version, "")
    return f"spz version {version}: {VERSIONS[version]}{older}"
