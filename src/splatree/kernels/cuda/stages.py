"""The stages one by one on a device, from structs to a struct as the other back ends have them.

Each copies its input there and its result back: for tests and for mixing back ends. A frame that stays on the device is
kernels/cuda/renderer.py.
"""

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cuda import plan
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_numbers
from splatree.kernels.cuda.plan import Blend, Sizes
from splatree.kernels.cuda.renderer import read_bins, read_contributions, read_splats, read_tile_work
from splatree.kernels.cuda.workspace import DeviceScene, Workspace
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins, tiles_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import ResolvedOptions, SelectOptions
from splatree.shapes import Array, Int32, UInt32

__all__ = ["Stages"]


class Stages:
    """The stages of a frame after the selection, on one device."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def project(
        self,
        gaussians: Gaussians,
        ids: UInt32[Array, "n"] | None,
        rows: Int32[Array, "v"],
        camera: Camera,
        options: ResolvedOptions,
        *,
        threads: int = 0,
    ) -> Splats:
        """Splats of the rows that touch the image; ``threads`` is not used."""
        if len(rows) and not (rows.min() >= 0 and rows.max() < len(gaussians)):
            raise InputError(f"rows: found {rows.min()} to {rows.max()}, wanted 0 to {len(gaussians) - 1}")
        scene = DeviceScene(self._device, gaussians, ids)
        work = self._workspace(scene, camera, options, num_rows=len(rows), degree=scene.sh_degree)
        work.fill("rows", rows[:, None])
        work.run(plan.project(_sizes(work)) + plan.order(_sizes(work)))
        return read_splats(work, rows)[0]

    def bin(
        self, splats: Splats, camera: Camera, options: ResolvedOptions, *, threads: int = 0, whole_box: bool = False
    ) -> TileBins:
        """Pairs of splat and tile, tile by tile and nearest first; ``threads`` is not used."""
        pairs = 4 * len(splats) + 64
        while True:
            work = self._workspace(None, camera, options, num_rows=len(splats), pairs=pairs, whole_box=whole_box)
            work.fill("records", splats.records.reshape(-1, 4))
            work.fill("depth_keys", splats.depths.view(np.uint32)[:, None])
            work.fill("order", splats.order[:, None])
            work.run(plan.bin_pairs(_sizes(work)))
            found = work.counts()["num_pairs"]
            if found <= pairs:
                return read_bins(work, camera, np.ones(len(splats), bool), len(splats))
            pairs = found

    def blend(
        self,
        splats: Splats,
        bins: TileBins,
        camera: Camera,
        options: ResolvedOptions,
        *,
        threads: int = 0,
        contributions: bool = False,
        kernel: Blend = "blend_16",
    ) -> Picture:
        """The picture of the tiles' lists, on request with the contribution of each pair; ``threads`` is not used."""
        work = self._workspace(None, camera, options, num_rows=len(splats), pairs=bins.num_pairs)
        work.fill("records", splats.records.reshape(-1, 4))
        work.fill("tile_start", bins.tile_start[:, None])
        side = "values_b" if plan.pair_side(_sizes(work)) else "values_a"
        work.fill(side, bins.splat_from_pair[:, None])
        if bins.floors is not None:
            work.fill("floors", bins.floors[:, None])
        if contributions:
            work.ensure("contributions", bins.num_pairs).clear()
        pictures = [work.ensure("image", 3 * camera.width * camera.height)]
        pictures += [work.ensure(name, camera.width * camera.height) for name in ("alpha", "depth")]
        self._write(work, camera, options)
        work.run(plan.blend(_sizes(work), kernel, contributions=contributions))
        image, alpha, depth = (array.numpy().reshape(camera.height, camera.width, -1) for array in pictures)
        of_pairs = read_contributions(work, bins.num_pairs) if contributions else None
        return Picture(image, alpha[:, :, 0].copy(), depth[:, :, 0].copy(), read_tile_work(work), of_pairs)

    def _workspace(
        self,
        scene: DeviceScene | None,
        camera: Camera,
        options: ResolvedOptions,
        *,
        num_rows: int,
        pairs: int = 0,
        degree: int = 0,
        whole_box: bool = False,
    ) -> Workspace:
        """A workspace whose input is as if so many rows had been selected."""
        num_x, num_y = tiles_of(camera)
        work = Workspace(self._device, scene)
        id_bits = scene.id_bits if scene else 0
        work.fit(Sizes(0, num_rows, pairs, num_x * num_y, id_bits, options.tapers, self._device.num_multiprocessors))
        work.clear()
        work.set_count("num_selected", num_rows)
        self._write(work, camera, options, degree=degree, whole_box=whole_box)
        return work

    def _write(self, work: Workspace, camera: Camera, options: ResolvedOptions, **how: int) -> None:
        whole_box, degree = bool(how.get("whole_box")), how.get("degree", 0)
        work.write_job(pack_numbers(camera, options, SelectOptions(), degree=degree, whole_box=whole_box))


def _sizes(work: Workspace) -> Sizes:
    assert work.sizes is not None
    return work.sizes
