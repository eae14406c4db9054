"""Clusters of Gaussians: runs of consecutive rows with spheres and boxes around them, and what K-means and culling leave."""

from dataclasses import dataclass

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SIGMAS
from splatree.errors import ShapeError
from splatree.maths.covariance import axes_from_gaussians
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Bool, Float32, Float64, Int32, Int64, check_fields, in_short


@dataclass(frozen=True, eq=False)
class ClusterIndex:
    """Clusters of rows: cluster ``j`` is the rows ``start[j] : start[j + 1]``, and each row is in one cluster.

    All radii are around the same centre, over the rows of the cluster. Radii and boxes are rounded outwards. In a tree,
    descendants of a row that lie in other clusters are held by those.

    Example:
        >>> clusters = st.build_clusters(st.read("city.ply"), 9).clusters
        >>> len(clusters), clusters.num_rows
        (9, 253)
    """

    start: Int32[Array, "c+1"]
    """First row of each cluster, and the number of rows."""
    centers: Float32[Array, "c 3"]
    """Centres of the spheres, world units."""
    radii: Float32[Array, "c"]
    """Radius that holds the 3σ balls: largest |μ − centre| + 3σ, σ the largest standard deviation (Jo 2024, Eq. 2)."""
    mean_radii: Float32[Array, "c"]
    """Radius that holds the means: largest |μ − centre| (the ablation "only distance" of Jo 2024)."""
    footprint_radii: Float32[Array, "c"]
    """Radius that holds everything drawn at τ = 1/255: largest |μ − centre| + k σ with k = √(2 ln 255 o), of rows of opacity o ≥
    1/255."""
    box_low: Float32[Array, "c 3"]
    """Smallest coordinates of the boxes along the world's axes that hold the centre and the kσ ellipsoids of the same rows."""
    box_high: Float32[Array, "c 3"]
    """Largest coordinates of these boxes: largest μ + k √Σ_ii along axis i."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_fields(self)
        if len(self.start) < 1 or self.start[0] != 0 or np.any(np.diff(self.start) <= 0):
            raise ShapeError("ClusterIndex.start: wanted rows from 0 on, ascending; a cluster has at least one row")

    def __len__(self) -> int:
        return len(self.centers)

    @property
    def num_rows(self) -> int:
        """Number of rows of all clusters."""
        return int(self.start[-1])

    @property
    def counts(self) -> Int32[Array, "c"]:
        """Number of rows of each cluster."""
        return np.diff(self.start)

    def fits(self, gaussians: Gaussians) -> bool:
        """Whether these are the clusters of the given Gaussians, judged by their number and by the first row of each cluster."""
        if self.num_rows != len(gaussians):
            return False
        first = self.start[:-1]
        logits = gaussians.logit_opacities[first].astype(np.float64)
        means = gaussians.means[first].astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            distances = np.linalg.norm(means - self.centers, axis=1)
            scales = np.exp(gaussians.log_scales[first].max(axis=1, initial=-np.inf).astype(np.float64))
            log_opacities = -np.logaddexp(0.0, -logits)
            reach = np.sqrt(2 * np.maximum(log_opacities - np.log(ALPHA_THRESHOLD), 0))
            drawn = log_opacities >= np.log(ALPHA_THRESHOLD)
            held = (
                (distances, self.mean_radii),
                (distances + SIGMAS * scales, self.radii),
                (np.where(drawn, distances + reach * scales, 0), self.footprint_radii),
            )
            axes = axes_from_gaussians(gaussians.quats[first], gaussians.log_scales[first])  # [c 3 3]
            spreads = np.where(drawn, reach, 0)[:, None] * np.sqrt((axes * axes).sum(axis=2))
            low, high = means - spreads, means + spreads
            slack = 1e-6 * (np.abs(means) + spreads + scales[:, None])
            if np.any(drawn[:, None] & ((low < self.box_low - slack) | (high > self.box_high + slack))):
                return False
            # NaN, which is never drawn, is above nothing; 1e-6 is the rounding of float32.
            return not any(np.any(needed > (1 + 1e-6) * radii.astype(np.float64)) for needed, radii in held)


@dataclass(frozen=True, eq=False)
class Assignment:
    """A step of K-means: the nearest centre of each point."""

    labels: Int32[Array, "n"]
    """Index of the centre; of equally near ones the first."""
    squared_distances: Float32[Array, "n"]
    """Squared distance to it."""
    sums: Float64[Array, "c 3"]
    """Sum of the points of each centre."""
    counts: Int64[Array, "c"]
    """Number of the points of each centre."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def inertia(self) -> float:
        """Sum of the squared distances, which K-means makes small."""
        return float(self.squared_distances.sum(dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Sides:
    """The borders of a view as planes in the world: a sphere that lies beyond one of them is out of view.

    Sphere (c, R) lies beyond side s if ``n_s · c + d_s > reach_s R'`` with R' = scale R + slack |c − eye|₁ + margin, the box
    with centre c and half sizes h if ``n_s · c + d_s > box_reach_s · h + reach_s (slack |c − eye|₁ + margin)``.
    """

    planes: Float64[Array, "5 4"]
    """(n, d) of right, left, bottom, top and near side, pointing outwards."""
    reaches: Float64[Array, "5"]
    """How far a unit of radius reaches over each plane."""
    eye: Float64[Array, "3"]
    """The eye in the world."""
    scale: float = 1.0
    """Factor on radii, which covers their rounding in float32."""
    slack: float = 0.0
    """Radius added for each unit of distance from the eye, which covers the rounding of positions in float32."""
    margin: float = 0.0
    """Radius added, which covers the rounding of the view's own translation in float32."""
    guard: bool = False
    """Whether spheres that reach the plane of the eye are kept whatever the sides say."""
    box_reaches: Float64[Array, "5 3"] | None = None
    """How far a unit of half size along each axis of the world reaches over each plane; None: spheres alone decide."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Culling:
    """The clusters of a scene that may be in the picture of a view.

    Example:
        >>> culling = st.cull(scene.clusters, camera)
        >>> len(culling.rows) == culling.num_rows
        True
    """

    kept: Bool[Array, "c"]
    """Whether each cluster is kept."""
    runs: Int32[Array, "r 2"]
    """First row and end of each run of kept rows, ascending, with gaps between them: nothing is copied or packed."""
    rule: str
    """Rule that decided (docs/explanation/clusters.md)."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def num_rows(self) -> int:
        """Number of rows of the kept clusters."""
        return int((self.runs[:, 1] - self.runs[:, 0]).sum(dtype=np.int64))

    @property
    def rows(self) -> Int32[Array, "v"]:
        """The kept rows, one by one (computed)."""
        begins, ends = self.runs.T
        sizes = ends - begins
        if not len(sizes):
            return np.zeros(0, np.int32)
        steps = np.ones(int(sizes.sum(dtype=np.int64)), np.int32)
        steps[0] = begins[0]
        steps[np.cumsum(sizes[:-1], dtype=np.int64)] = begins[1:] - ends[:-1] + 1
        return np.cumsum(steps, dtype=np.int32)
