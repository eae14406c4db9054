"""The memory of a frame on a device, and the job that tells kernels where it lies.

Arrays only grow. What a frame needs at once: 64 + 28 bytes a row, 12 a pair (16 in pictures of more than 65,536
tiles; pairs and rows share the sides of the sort), 16 a pixel with 20 for the picture itself.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from splatree.errors import DeviceError
from splatree.kernels.cuda.driver import Device, DeviceArray, Event, PinnedArray
from splatree.kernels.cuda.job import COUNTERS, array_dtypes, pack_job
from splatree.kernels.cuda.plan import DIGITS, NUM_PASSES, NUM_SCANS, SORT_TILE, Launch, Sizes
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.shapes import Array, Float32, UInt32

__all__ = ["DeviceScene", "Workspace"]

MOST_PAIRS = 2**31 - SORT_TILE
"""Places of pairs are kept in 32 bits."""


class DeviceScene:
    """The columns of a scene in device memory: 60 bytes a row and 12 a coefficient of the harmonics."""

    def __init__(
        self,
        device: Device,
        gaussians: Gaussians,
        ids: UInt32[Array, "n"] | None,
        tree: GaussianTree | None = None,
        blocks: BlockIndex | None = None,
        on_device: Mapping[str, DeviceArray] = MappingProxyType({}),
        curves: Float32[Array, "n 4"] | None = None,
    ) -> None:
        """Without a tree the rows can be projected but not selected; columns that are ``on_device`` are not copied.

        ``curves`` are those of the tree, which is asked for them if there is one.
        """
        self.num_rows, self.sh_degree = len(gaussians), gaussians.sh_degree
        self.num_blocks = len(blocks) if blocks else 0
        self.has_ids = ids is not None
        columns: dict[str, Array | None] = {
            name: getattr(gaussians, name) for name in GAUSSIAN_COLUMNS if name not in on_device
        }
        columns["ids"] = ids
        columns["curves"] = tree.curves if tree is not None else curves
        self.sizes = {"num_rows": self.num_rows, "num_coefficients": gaussians.sh.shape[1]}
        self.sizes["follows"] = int(columns["curves"] is not None)
        if tree is not None and blocks is not None:
            columns |= {"extents": tree.extents, "subtree_end": tree.subtree_end}
            columns |= {"block_lower": blocks.lower, "block_upper": blocks.upper}
            columns |= {name: getattr(blocks, name) for name in BLOCK_COLUMNS}
            words = -(-blocks.rows_per_block // 32)
            self.sizes |= {"num_blocks": len(blocks), "rows_per_block": blocks.rows_per_block, "words_per_block": words}
        uploaded = {name: device.upload(host, name=name) for name, host in columns.items() if host is not None}
        self.arrays = {**on_device, **uploaded}
        self._device, self._borrowed = device, set(on_device)

    def update(self, gaussians: Gaussians, blocks: BlockIndex | None, names: Sequence[str]) -> None:
        """Copy the named columns and the index of the blocks here; memory that belongs to others is left as it is."""
        for name in names:
            if name in self._borrowed:
                self.arrays[name] = self._device.upload(getattr(gaussians, name), name=name)
                self._borrowed.remove(name)
            else:
                self.arrays[name].fill(getattr(gaussians, name))
        if blocks is None:
            return
        self.arrays["block_lower"].fill(blocks.lower)
        self.arrays["block_upper"].fill(blocks.upper)
        for name in BLOCK_COLUMNS:
            self.arrays[name].fill(getattr(blocks, name))


GAUSSIAN_COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
BLOCK_COLUMNS = ("leaf_scales", "min_logits", "size_classes", "ancestor_start", "ancestors")


class Workspace:
    """Arrays of a frame by the names of job.h."""

    def __init__(self, device: Device, scene: DeviceScene | None = None) -> None:
        self.device, self.scene = device, scene
        self.arrays: dict[str, DeviceArray] = {}
        self.sizes: Sizes | None = None
        self._job: DeviceArray | None = None
        self._staged: list[tuple[PinnedArray, Event]] = []

    def fit(self, sizes: Sizes) -> bool:
        """Make room; whether memory that a recorded frame clears has moved."""
        if sizes.pairs > MOST_PAIRS or sizes.rows > MOST_PAIRS:
            raise DeviceError(
                f"frame: found {max(sizes.rows, sizes.pairs):,} rows or pairs, wanted at most {MOST_PAIRS:,}; draw a coarser "
                f"cut (pixel_error) or a smaller picture"
            )
        before = [self.arrays.get(name) for name in CLEARED]
        both = max(sizes.rows, sizes.pairs)
        words = self.scene.sizes.get("words_per_block", 0) if self.scene else 0
        lengths = {
            "open_blocks": sizes.num_blocks,
            "kept_masks": sizes.num_blocks * words,
            "num_kept": sizes.num_blocks,
            "first_kept": sizes.num_blocks,
            "rows": sizes.rows,
            "records": 4 * sizes.rows,
            **dict.fromkeys(("depth_keys", "order"), sizes.rows),
            **dict.fromkeys(("values_a", "values_b"), both),
            **dict.fromkeys(("keys_a", "keys_b"), sizes.rows if sizes.has_short_keys else both),
            **dict.fromkeys(("tile_keys_a", "tile_keys_b"), sizes.pairs if sizes.has_short_keys else 0),
            "floors": sizes.rows if sizes.tapers else 0,
            "tile_start": sizes.num_tiles + 1,
            "tile_order": sizes.num_tiles,
            "tile_work": 3 * sizes.num_tiles,
            "counters": len(COUNTERS) + 2,
            "tickets": NUM_SCANS + NUM_PASSES,
            "histograms": DIGITS * NUM_PASSES,
            "sweeps": sizes.num_swept,
            "chains": NUM_SCANS * sizes.chain_stride,
        }
        for name, length in lengths.items():
            self.ensure(name, length)
        self.sizes = sizes
        return before != [self.arrays[name] for name in CLEARED]

    def ensure(self, name: str, length: int) -> DeviceArray:
        """The array of that name, at least so long; what it held is lost if it has to grow."""
        dtype, width = array_dtypes()[name]
        array = self.arrays.get(name)
        if array is None or len(array) < length:
            self.arrays.pop(name, None)
            del array  # give the memory back before more is asked for
            array = self.arrays[name] = self.device.empty((length, width), dtype, name=name)
        return array

    def fill(self, name: str, values: Array) -> None:
        """Put values into an array."""
        self.ensure(name, len(values)).fill(values)

    def write_job(self, numbers: bytes, extra: Mapping[str, DeviceArray] | None = None, **sizes: int) -> None:
        """Tell the kernels where everything lies."""
        assert self.sizes is not None
        arrays = {**(self.scene.arrays if self.scene else {}), **self.arrays, **(extra or {})}
        pointers = {name: array.pointer for name, array in arrays.items()}
        own = {
            "row_capacity": self.sizes.rows,
            "pair_capacity": self.sizes.pairs,
            "chain_stride": self.sizes.chain_stride,
        }
        packed = pack_job(numbers, pointers, {**(self.scene.sizes if self.scene else {}), **own, **sizes})
        if self._job is None:
            self._job = self.device.empty((len(packed),), np.uint8, name="job")
        pinned, passed = self._staging(len(packed))
        pinned.values[:] = packed
        pinned.send(self._job)
        passed.record()

    def _staging(self, num_bytes: int) -> tuple[PinnedArray, Event]:
        """Pinned memory that no copy under way reads: as many as there are frames under way, and nobody waits."""
        for staged in self._staged:
            if staged[1].has_passed():
                return staged
        self._staged.append((self.device.pinned((num_bytes,), np.uint8), self.device.event()))
        return self._staged[-1]

    def clear(self) -> None:
        """Set counters and what thread blocks wait for to zero, as each frame begins."""
        for name in CLEARED:
            self.arrays[name].clear()

    def run(self, launches: Sequence[Launch]) -> None:
        """Enqueue kernels."""
        assert self._job is not None
        for launch in launches:
            self.device.launch(launch.kernel, launch.num_thread_blocks, self._job, launch.argument)

    def counts(self) -> dict[str, int]:
        """The counters; waits for the device."""
        return dict(zip(COUNTERS, self.arrays["counters"].numpy()[:, 0].tolist(), strict=False))

    def set_counts(self, **counts: int) -> None:
        """Give counters their values and 0 to all others, for stages whose input comes from the host."""
        values = np.zeros((len(self.arrays["counters"]), 1), np.uint64)
        for name, count in counts.items():
            values[COUNTERS.index(name)] = count
        self.arrays["counters"].fill(values)


CLEARED = ("counters", "tickets", "chains", "histograms", "sweeps", "tile_work")
