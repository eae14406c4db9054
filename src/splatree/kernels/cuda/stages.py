"""The stages of a frame and of training one by one on a device, from structs to a struct as the other back ends have them.

Each copies its input there and its result back: for tests and for mixing back ends. A frame that stays on the device is
kernels/cuda/renderer.py.
"""

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cuda import plan
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_numbers
from splatree.kernels.cuda.loss import photo_loss
from splatree.kernels.cuda.optimise import step
from splatree.kernels.cuda.plan import Blend, Sizes
from splatree.kernels.cuda.renderer import Renderer
from splatree.kernels.cuda.results import (
    NUM_SUMS,
    prepare_outputs,
    read_bins,
    read_gradients,
    read_outputs,
    read_splats,
    read_sums,
    sums_of,
    width_of,
)
from splatree.kernels.cuda.workspace import DeviceScene, Workspace
from splatree.kernels.reference.backward import refuse_tapers
from splatree.kernels.reference.optimise import COLUMNS
from splatree.kernels.reference.select import in_runs
from splatree.scene.frame import Picture, Splats, TileBins, tiles_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments, PhotoLoss, PictureGradients, SplatGradients
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float32, Float64, Int32, UInt8, UInt32

__all__ = ["Stages"]


class Stages:
    """The stages on one device."""

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

    def blend_backward(
        self,
        splats: Splats,
        bins: TileBins,
        view: View,
        picture: Picture,
        upstream: PictureGradients,
        *,
        threads: int = 0,
    ) -> SplatGradients:
        """Sums over the pixels of each splat; ``threads`` is not used."""
        refuse_tapers(bins, view)
        camera, pairs = view.camera, bins.num_pairs
        work = self._workspace(None, view, num_rows=len(splats), pairs=pairs, given_pairs=True)
        work.fill("records", splats.records.reshape(-1, 4))
        work.fill("tile_start", bins.tile_start[:, None])
        work.fill("values_b" if plan.pair_side(_sizes(work)) else "values_a", bins.splat_from_pair[:, None])
        given = {
            **{"image": picture.image, "alpha": picture.alpha, "depth": picture.depth, "by_image": upstream.image},
            **{"by_alpha": upstream.alpha, "by_depth": upstream.depth, "pixel_errors": upstream.errors},
        }
        for name, values in given.items():
            if values is None:
                work.ensure(name, camera.width * camera.height).clear()
            else:
                work.fill(name, values.reshape(-1, 1))
        for name in ("keys_a", "keys_b"):  # pairs are sorted by splat
            work.ensure(name, pairs)
        work.ensure("sweeps", _sizes(work).num_swept_by(plan.splat_bits(_sizes(work)))).clear()
        work.ensure("pair_sums", NUM_SUMS * pairs)
        work.ensure("splat_sums", NUM_SUMS * len(splats))
        self._write(work, view)
        work.run(plan.blend_backward(_sizes(work)))
        return read_sums(work, len(splats), upstream)

    def project_backward(
        self, gaussians: Gaussians, splats: Splats, gradients: SplatGradients, view: View, *, threads: int = 0
    ) -> GaussianGradients:
        """Derivatives by the columns of the Gaussians that the splats come from; ``threads`` is not used."""
        count = len(splats)
        scene = DeviceScene(self._device, gaussians.take(splats.rows), None)
        work = self._workspace(scene, view, num_rows=count, degree=scene.sh_degree)
        work.fill("rows", np.arange(count, dtype=np.int32)[:, None])
        work.fill("records", splats.records.reshape(-1, 4))
        work.fill("splat_sums", sums_of(gradients).reshape(-1, 1))
        for name in COLUMNS:
            work.ensure(f"by_{name}", count * width_of(gaussians, name))
        self._write(work, view, degree=scene.sh_degree)
        work.run(plan.project_backward(_sizes(work)))
        return read_gradients(work, splats.rows, gaussians)

    def photo_loss(
        self,
        image: Float32[Array, "h w 3"],
        photo: UInt8[Array, "h w 3"],
        gain: Float64[Array, "3"],
        *,
        ssim_weight: float = 0.2,
        mask: Bool[Array, "h w"] | None = None,
        threads: int = 0,
    ) -> PhotoLoss:
        """The loss against a photograph and its derivative; ``threads`` is not used."""
        return photo_loss(self._device, image, photo, gain, ssim_weight, mask)

    def step(
        self,
        gaussians: Gaussians,
        gradients: GaussianGradients,
        moments: Moments,
        rates: Float32[Array, "e"],
        *,
        ramp_steps: int = 1,
        threads: int = 0,
    ) -> None:
        """A step of the optimiser for the rows that were drawn; ``threads`` is not used."""
        step(self._device, gaussians, gradients, moments, rates, ramp_steps)

    def _workspace(
        self,
        scene: DeviceScene | None,
        view: View,
        *,
        num_rows: int,
        pairs: int = 0,
        degree: int = 0,
        whole_box: bool = False,
        given_pairs: bool = False,
    ) -> Workspace:
        """A workspace whose input is as if so many rows had been selected, and so many pairs been listed if they are given."""
        num_x, num_y = tiles_of(view.camera)
        work = Workspace(self._device, scene)
        has_ids = scene is not None and scene.has_ids
        work.fit(Sizes(0, num_rows, pairs, num_x * num_y, has_ids, view.tapers, self._device.num_multiprocessors))
        work.clear()
        work.set_counts(num_selected=num_rows, num_pairs=pairs if given_pairs else 0)
        self._write(work, view, degree=degree, whole_box=whole_box)
        return work

    def _write(self, work: Workspace, view: View, **how: int) -> None:
        whole_box, degree = bool(how.get("whole_box")), how.get("degree", 0)
        work.write_job(pack_numbers(view, SelectOptions(), degree=degree, whole_box=whole_box))


def _sizes(work: Workspace) -> Sizes:
    assert work.sizes is not None
    return work.sizes
