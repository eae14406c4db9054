"""What the circuit computes, in whole numbers: clusters and views as it takes them, and its decision.

The exact rule drops a cluster (c, R) if n·c + d > ρ R for one of four side planes (docs/explanation/clusters.md). Divided by ρ,
the plane's normal is at most one long. What is left is a sum of three products and a comparison. Coordinates are whole multiples
of a unit u, weights whole multiples of 2⁻¹⁶. Rounding must never drop a cluster. So radii are rounded outwards by all that
rounding can add on the left:

    each coordinate is off by at most u/2, and |n| ≤ 1:      √3/2 u
    each weight is off by at most 2⁻¹⁷, and |c_i| ≤ C u:     3 C 2⁻¹⁷ u
    the offset is off by at most half of its last place:     2⁻¹⁷ u

The rule `paper` is Eq. 3 of Jo 2024 without its division: a cluster is kept if |X| − R ≤ t_x Z, |Y| − R ≤ t_y Z and Z > 0,
where t is the tangent of half the field of view.
"""

from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.scene.cameras import Camera
from splatree.scene.clusters import ClusterIndex, Sides
from splatree.shapes import Array, Bool, Float64, Int64

__all__ = ["CieClusters", "CieView", "clusters_of", "decide", "exact_view", "paper_view"]

COORDINATE_BITS = 24
"""Bits of a coordinate and of a radius, the sign included."""
WEIGHT_BITS = 18
"""Bits of a weight, the sign included."""
FRACTION_BITS = 16
"""Of these, behind the point."""
OFFSET_BITS = 48
"""Bits of an offset, with as many behind the point."""
NUM_ROWS = 4
"""Rows of multipliers: the four side planes, or X, Y and Z."""

LARGEST = 2 ** (COORDINATE_BITS - 1) - 1
ROUNDED = int(np.ceil(3**0.5 / 2 + 3 * (LARGEST + 1) * 2.0**-17 + 2.0**-17)) + 1
"""Units added to each radius: what rounding of coordinates, weights and offset can add on the left."""


@dataclass(frozen=True, eq=False)
class CieClusters:
    """Clusters in the circuit's numbers."""

    centers: Int64[Array, "c 3"]
    """Centres in units, from ``origin``."""
    radii: Int64[Array, "c"]
    """Radii in units, rounded outwards."""
    origin: Float64[Array, "3"]
    """World coordinates of the middle of the scene."""
    unit: float
    """World units of one step."""


@dataclass(frozen=True, eq=False)
class CieView:
    """A view in the circuit's numbers."""

    weights: Int64[Array, "4 3"]
    """Rows of the multipliers, 16 bits behind the point."""
    offsets: Int64[Array, "4"]
    """Added to each row, in units, 16 bits behind the point."""
    slopes: Int64[Array, "2"]
    """Tangents of half the fields of view, 16 bits behind the point; only the rule `paper` uses them."""
    is_paper: bool
    """Eq. 3 instead of four planes."""


def clusters_of(clusters: ClusterIndex, radii: Array) -> CieClusters:
    """Quantise the spheres of a scene.

    Args:
        clusters: whose centres are taken.
        radii: radius of each for the rule at hand, world units (c).
    """
    centers, radii = clusters.centers.astype(np.float64), radii.astype(np.float64)
    low, high = centers.min(axis=0), centers.max(axis=0)
    origin = (low + high) / 2
    reach = max(float((high - origin).max()), float(radii.max()), 1e-30)
    unit = reach / (LARGEST - ROUNDED - 2)
    rounded = np.rint((centers - origin) / unit).astype(np.int64)
    return CieClusters(rounded, np.ceil(radii / unit).astype(np.int64) + ROUNDED, origin, unit)


def exact_view(sides: Sides, clusters: CieClusters) -> CieView:
    """The four side planes of an exact rule (`clusters.cull.sides_of`).

    What the rule adds to a radius with its distance from the eye is added for the farthest point of the scene, to the plane. The
    factor that it puts on radii is for `clusters_of`, whose radii must have it.

    Raises:
        InputError: a plane is too far from the scene for the bits of an offset.
    """
    normals = sides.planes[:NUM_ROWS, :3] / sides.reaches[:NUM_ROWS, None]
    at_origin = sides.planes[:NUM_ROWS, :3] @ clusters.origin + sides.planes[:NUM_ROWS, 3]
    farthest = np.abs(clusters.origin - sides.eye).sum() + 3 * (LARGEST + 1) * clusters.unit
    added = sides.slack * farthest + sides.margin
    offsets = (at_origin / sides.reaches[:NUM_ROWS] - added) / clusters.unit
    return CieView(_weights(normals), _offsets(offsets), np.zeros(2, np.int64), False)


def paper_view(camera: Camera, clusters: CieClusters) -> CieView:
    """Eq. 3 for a camera whose principal point is in the middle."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    weights = np.zeros((NUM_ROWS, 3))
    weights[:3] = rotation
    offsets = np.zeros(NUM_ROWS)
    offsets[:3] = (rotation @ clusters.origin + translation) / clusters.unit
    slopes = np.array([camera.width / 2 / camera.K[0, 0], camera.height / 2 / camera.K[1, 1]])
    if slopes.max() >= 2 ** (WEIGHT_BITS - FRACTION_BITS - 1):
        raise InputError(f"rtl: found a field of view with a tangent of {slopes.max():.2f}, wanted less than 2")
    return CieView(_weights(weights), _offsets(offsets), np.rint(slopes * 2**FRACTION_BITS).astype(np.int64), True)


def decide(clusters: CieClusters, view: CieView) -> Bool[Array, "c"]:
    """Whether the circuit keeps each cluster: its arithmetic in whole numbers, without a circuit."""
    sums = clusters.centers @ view.weights.T + view.offsets  # [c 4]
    radii = clusters.radii << FRACTION_BITS
    if not view.is_paper:
        return np.asarray(np.all(sums <= radii[:, None], axis=1))
    x, y, z = sums[:, :3].T
    right = [(slope * (z >> FRACTION_BITS)) for slope in view.slopes]
    kept = (np.abs(x) - radii <= right[0]) & (np.abs(y) - radii <= right[1]) & (z > 0)
    return np.asarray(kept)


def _weights(weights: Array) -> Int64[Array, "4 3"]:
    rounded = np.asarray(np.rint(weights * 2**FRACTION_BITS), np.int64)
    if np.abs(rounded).max() >= 2 ** (WEIGHT_BITS - 1):
        raise InputError(f"rtl: found a plane's normal of length {np.abs(weights).max():.2f}, wanted at most 1")
    return rounded


def _offsets(offsets: Array) -> Int64[Array, "4"]:
    if np.abs(offsets).max() >= 2 ** (OFFSET_BITS - FRACTION_BITS - 2):
        raise InputError(
            f"rtl: found an eye {np.abs(offsets).max():.3g} units from the scene, wanted less than 2³⁰; move it"
        )
    return np.asarray(np.rint(offsets * 2**FRACTION_BITS), np.int64)
