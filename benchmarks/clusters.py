"""K-means of a whole city beside its peers: CPU-seconds an iteration, inertia against brute force; and cluster culling on it.

splatree       kernels/cpu/kmeans: exact Lloyd, candidates for 64 points at once from a tree over the centres
faiss          faiss-cpu: brute force on all points
scipy          cKDTree over the centres, one query a point
scikit-learn   KMeans(algorithm="lloyd"), on fewer points: the whole would take hours

All start at the same centres. The peers run with the Python given by --peers, which has to have them; what is missing is left
out. Run: python benchmarks/clusters.py [--points 6000000] [--clusters 1024 8192 32768] [--peers PYTHON]
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from harness import DATA, measure, save, table
from splatree import read
from splatree.kernels.cpu.build.kmeans import assign
from splatree.maths.morton import morton_codes

CITY = DATA / "trained" / "semarang_city"
SKLEARN_POINTS = 100_000
SAMPLE = 2000
"""Points whose nearest centre is also found by brute force, in float64."""

PEERS = """
import json, resource, sys, time
import numpy as np
points, centers = np.load(sys.argv[1]), np.load(sys.argv[2])
sklearn_points = int(sys.argv[3])
def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
found = {}
try:
    import faiss
    index = faiss.IndexFlatL2(3); index.add(centers)
    start = cpu(); distances, _ = index.search(points, 1)
    found["faiss"] = [cpu() - start, float(distances.sum(dtype=float)), len(points)]
except ImportError:
    pass
try:
    from scipy.spatial import cKDTree
    start = cpu(); distances, _ = cKDTree(centers).query(points, workers=2)
    found["scipy"] = [cpu() - start, float((distances ** 2).sum()), len(points)]
except ImportError:
    pass
try:
    from sklearn.cluster import KMeans
    few = points[:: max(1, len(points) // sklearn_points)]
    start = cpu(); made = KMeans(len(centers), init=centers, n_init=1, max_iter=1, algorithm="lloyd").fit(few)
    found["scikit-learn"] = [(cpu() - start) / 2, None, len(few)]  # an iteration and the final labels
except ImportError:
    pass
print(json.dumps(found))
"""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=6_000_000)
    parser.add_argument("--clusters", type=int, nargs="+", default=[1024, 8192, 32768])
    parser.add_argument("--peers", type=Path)
    options = parser.parse_args()
    if not CITY.exists():
        sys.exit(f"clusters: {DATA} is not there; this benchmark needs the shared scenes")
    points, sort_s = load(options.points)
    print(f"{len(points):,} points, sorted along a Morton curve in {sort_s:.2f} CPU-s\n")
    rows = [row for number in options.clusters for row in rows_of(points, number, options.peers)]
    print(table(rows))
    save(
        "clusters",
        rows,
        about=f"An iteration of K-means on {len(points):,} points of a real city (what is missing is "
        "the city again, moved by a millimetre), from the same centres: CPU-seconds, and inertia over that of brute force. "
        f"scikit-learn ran on {SKLEARN_POINTS:,} points.",
    )


def load(count: int) -> tuple[np.ndarray, float]:
    """The city's means around their median, repeated with a small shift up to ``count``, in Morton order."""
    means = read(CITY).gaussians.means
    while len(means) < count:
        means = np.concatenate([means, means[: count - len(means)] + np.float32(1e-3)])
    means = means[:count]
    start = time.process_time()
    order = np.argsort(morton_codes(means), kind="stable")
    points = np.take(means - np.median(means, axis=0), order, axis=0).astype(np.float32)
    return points, time.process_time() - start


def rows_of(points: np.ndarray, number: int, peers: Path | None) -> list[dict[str, object]]:
    """One iteration by each; inertia is that of the assignment to the same centres."""
    rng = np.random.default_rng(0)
    centers = points[np.sort(rng.choice(len(points), number, replace=False))]
    ours = measure(lambda: assign(points, centers), repeat=3)
    sample = rng.choice(len(points), SAMPLE, replace=False)
    squares = (centers.astype(np.float64) ** 2).sum(axis=1)
    brute = sum(
        float(np.maximum(squares - 2 * (centers @ p.astype(np.float64)) + p @ p, 0).min())
        for p in points[sample].astype(np.float64)
    )
    inertia = ours.value.squared_distances[sample].sum(dtype=np.float64)
    rows: list[dict[str, object]] = [
        {
            "clusters": number,
            "by": "splatree",
            "points": len(points),
            "CPU s an iteration": ours.cpu_s,
            "x ours": 1.0,
            "inertia / brute force - 1": inertia / brute - 1,
        }
    ]
    for name, (cpu_s, total, count) in peers_of(points, centers, peers).items():
        per_point = (cpu_s / count) / (ours.cpu_s / len(points))
        row = {"clusters": number, "by": name, "points": count, "CPU s an iteration": cpu_s, "x ours": per_point}
        if total is not None:
            row["inertia / brute force - 1"] = total / ours.value.inertia * inertia / brute - 1
        rows.append(row)
    return rows


def peers_of(points: np.ndarray, centers: np.ndarray, python: Path | None) -> dict[str, list[float]]:
    """CPU-seconds, inertia and number of points of each peer that is there."""
    if python is None:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        names = [Path(folder) / name for name in ("points.npy", "centers.npy")]
        for name, values in zip(names, (points, centers), strict=True):
            np.save(name, values)
        words = [str(python), "-c", PEERS, *map(str, names), str(SKLEARN_POINTS)]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


if __name__ == "__main__":
    main()
