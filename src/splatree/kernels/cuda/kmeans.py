"""Steps of K-means on a device; kernels/reference/kmeans.py is the definition.

The points lie there from the first step to the last; a step takes the centres there, and brings back sums, numbers and inertia:
32 bytes a centre and 8 for 64 points. Labels and distances stay, until somebody asks for them.

    sum = Σ round(x 2^b),   b as large as n points of this size allow in 64 bits

Whole numbers add up to the same bits in any order. They hold each point to 2^-(b+1), for 6 M points 2^-40 of the largest
coordinate; the processor's sums are of float64, so that centres may differ from its by the last bit of a float32, not more
where a coordinate is more than 2^-16 of the largest.

Cost of a step: a pass over the boxes of c / 32 leaves for each 64 points, and some hundred centres a point.
"""

import math
from functools import cached_property

import numpy as np

from splatree.kernels.cuda.driver import Device, DeviceArray
from splatree.kernels.cuda.job import pack_fields
from splatree.kernels.cuda.sources import threads_of
from splatree.shapes import Array, Float32, Float64, Int32, Int64

__all__ = ["DeviceAssignment", "DevicePoints"]

LEAF_CENTERS, WARP_POINTS, WARP = 32, 64, 32
"""Centres of a leaf, points of a warp, threads of a warp (kmeans.cu)."""
SUM_BITS = 62
"""Of a sum, with its sign one less than a word has."""


class DevicePoints:
    """Points on a device, and the steps of K-means with them."""

    def __init__(self, device: Device, points: Float32[Array, "n 3"]) -> None:
        """Finite, at least one; fast if neighbours in the list are near in space."""
        self.device, self._num_points = device, len(points)
        largest = float(np.abs(points).max())
        size = math.frexp(largest)[1] if largest else 0  # below 2^size
        self.sum_bits = SUM_BITS - size - (len(points) - 1).bit_length()
        self._arrays = {
            "points": device.upload(points, name="points"),
            "labels": device.empty((len(points),), np.int32, name="labels"),
            "squared_distances": device.empty((len(points),), np.float32, name="squared_distances"),
            "inertia": device.empty((-(-len(points) // WARP_POINTS),), np.float64, name="inertia"),
        }
        self._job: DeviceArray | None = None

    def assign(self, centers: Float32[Array, "c 3"]) -> "DeviceAssignment":
        """The nearest centre of each point; what was found before is written over."""
        self._ensure(len(centers))
        self._arrays["centers"].fill(centers)
        self._arrays["sums"].clear()
        self._arrays["counts"].clear()
        pointers = {name: array.pointer for name, array in self._arrays.items()}
        sizes = {"num_points": self._num_points, "num_centers": len(centers), "sum_bits": self.sum_bits}
        packed = pack_fields("cuda/kmeans.h", "KmeansJob", pointers, sizes)
        if self._job is None:
            self._job = self.device.empty(packed.shape, packed.dtype, name="job")
        self._job.fill(packed)
        for kernel, warps in (
            ("box_centers", -(-len(centers) // LEAF_CENTERS)),
            ("label_points", -(-self._num_points // WARP_POINTS)),
        ):
            self.device.launch(kernel, -(-warps * WARP // threads_of(kernel)), self._job)
        return DeviceAssignment(self._arrays, self.sum_bits)

    def _ensure(self, num_centers: int) -> None:
        found = self._arrays.get("centers")
        if found is not None and len(found) == num_centers:
            return
        shapes = {
            "centers": ((num_centers, 3), np.float32),
            "boxes": ((-(-num_centers // LEAF_CENTERS), 6), np.float32),
            "sums": ((num_centers, 3), np.uint64),
            "counts": ((num_centers,), np.uint64),
        }
        for name, (shape, dtype) in shapes.items():
            self._arrays[name] = self.device.empty(shape, dtype, name=name)


class DeviceAssignment:
    """A step of K-means as `Assignment` has it, copied from the device as far as it is asked for, before the next step."""

    def __init__(self, arrays: dict[str, DeviceArray], sum_bits: int) -> None:
        self._arrays = arrays
        self.sums: Float64[Array, "c 3"] = np.ldexp(arrays["sums"].numpy().view(np.int64).astype(np.float64), -sum_bits)
        """Sum of the points of each centre."""
        self.counts: Int64[Array, c] = arrays["counts"].numpy().view(np.int64)
        """Number of the points of each centre."""
        self.inertia = float(arrays["inertia"].numpy().sum())
        """Sum of the squared distances."""

    @cached_property
    def labels(self) -> Int32[Array, "n"]:
        """Index of the nearest centre; of equally near ones the first."""
        return self._arrays["labels"].numpy()

    @cached_property
    def squared_distances(self) -> Float32[Array, "n"]:
        """Squared distance to it."""
        return self._arrays["squared_distances"].numpy()
