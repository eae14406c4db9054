"""The stages one by one on a device, from structs to a struct as the other back ends have them.

Each copies its input there and its result back: for tests and for mixing back ends. A frame that stays on the device is
kernels/cuda/renderer.py.
"""

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cuda import plan
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_numbers
from splatree.kernels.cuda.plan import Blend, Sizes
from splatree.kernels.cuda.renderer import Renderer
from splatree.kernels.cuda.results import prepare_outputs, read_bins, read_outputs, read_splats
from splatree.kernels.cuda.workspace import DeviceScene, Workspace
from splatree.kernels.reference.select import in_runs
from splatree.scene.frame import Picture, Splats, TileBins, tiles_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, UInt32

__all__ = ["Stages"]


class Stages:
    """The stages of a frame after the selection, on one device."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def select(
        self,
        gaussians: Gaussians,
        tree: GaussianTree,
        blocks: BlockIndex | None,
        view: View,
        options: SelectOptions,
        *,
        runs: Int32[Array, "r 2"] | None = None,
        threads: int = 0,
    ) -> tuple[Int32[Array, "v"], int]:
        """Rows drawn by the rule `cut`, ascending, and how many were looked at; ``threads`` is not used."""
        blocks = blocks or index_blocks(gaussians, tree)
        rows, num_visited = Renderer(self._device, gaussians, tree, blocks, pairs=1).select(view, options)
        return (rows if runs is None else rows[in_runs(rows, runs)]), num_visited

    def project(
        self,
        gaussians: Gaussians,
        ids: UInt32[Array, "n"] | None,
        rows: Int32[Array, "v"],
        view: View,
        *,
        curves: Float32[Array, "n 4"] | None = None,
        threads: int = 0,
    ) -> Splats:
        """Splats of the rows that touch the image; ``threads`` is not used."""
        if len(rows) and not (rows.min() >= 0 and rows.max() < len(gaussians)):
            raise InputError(f"rows: found {rows.min()} to {rows.max()}, wanted 0 to {len(gaussians) - 1}")
        scene = DeviceScene(self._device, gaussians, ids, curves=curves)
        work = self._workspace(scene, view, num_rows=len(rows), degree=scene.sh_degree)
        work.fill("rows", rows[:, None])
        work.run(plan.project(_sizes(work)) + plan.order(_sizes(work)))
        return read_splats(work, rows)[0]

    def bin(self, splats: Splats, view: View, *, threads: int = 0, whole_box: bool = False) -> TileBins:
        """Pairs of splat and tile, tile by tile and nearest first; ``threads`` is not used."""
        pairs = 4 * len(splats) + 64
        while True:
            work = self._workspace(None, view, num_rows=len(splats), pairs=pairs, whole_box=whole_box)
            work.fill("records", splats.records.reshape(-1, 4))
            work.fill("depth_keys", splats.depths.view(np.uint32)[:, None])
            work.fill("order", splats.order[:, None])
            work.run(plan.bin_pairs(_sizes(work)))
            found = work.counts()["num_pairs"]
            if found <= pairs:
                return read_bins(work, view.camera, np.ones(len(splats), bool), len(splats))
            pairs = found

    def blend(
        self,
        splats: Splats,
        bins: TileBins,
        view: View,
        *,
        threads: int = 0,
        kernel: Blend = "blend_16",
    ) -> Picture:
        """The picture of the tiles' lists, with the outputs that the view wants; ``threads`` is not used."""
        camera = view.camera
        work = self._workspace(None, view, num_rows=len(splats), pairs=bins.num_pairs)
        work.fill("records", splats.records.reshape(-1, 4))
        work.fill("tile_start", bins.tile_start[:, None])
        side = "values_b" if plan.pair_side(_sizes(work)) else "values_a"
        work.fill(side, bins.splat_from_pair[:, None])
        if bins.floors is not None:
            work.fill("floors", bins.floors[:, None])
        prepare_outputs(work, view, bins.num_pairs)
        pictures = [work.ensure("image", 3 * camera.width * camera.height)]
        pictures += [work.ensure(name, camera.width * camera.height) for name in ("alpha", "depth")]
        self._write(work, view)
        work.run(plan.blend(_sizes(work), kernel, view.wanted))
        image, alpha, depth = (array.numpy().reshape(camera.height, camera.width, -1) for array in pictures)
        others = read_outputs(work, view, bins.num_pairs)
        return Picture(image, alpha[:, :, 0].copy(), depth[:, :, 0].copy(), **others)

    def _workspace(
        self,
        scene: DeviceScene | None,
        view: View,
        *,
        num_rows: int,
        pairs: int = 0,
        degree: int = 0,
        whole_box: bool = False,
    ) -> Workspace:
        """A workspace whose input is as if so many rows had been selected."""
        num_x, num_y = tiles_of(view.camera)
        work = Workspace(self._device, scene)
        id_bits = scene.id_bits if scene else 0
        work.fit(Sizes(0, num_rows, pairs, num_x * num_y, id_bits, view.tapers, self._device.num_multiprocessors))
        work.clear()
        work.set_count("num_selected", num_rows)
        self._write(work, view, degree=degree, whole_box=whole_box)
        return work

    def _write(self, work: Workspace, view: View, **how: int) -> None:
        whole_box, degree = bool(how.get("whole_box")), how.get("degree", 0)
        work.write_job(pack_numbers(view, SelectOptions(), degree=degree, whole_box=whole_box))


def _sizes(work: Workspace) -> Sizes:
    assert work.sizes is not None
    return work.sizes
