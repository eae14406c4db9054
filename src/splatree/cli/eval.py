"""``splatree eval``: what the levels of detail cost in quality and save in work."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from splatree.cli.console import Console, table
from splatree.errors import InputError
from splatree.io.cameras import read_cameras
from splatree.io.photos import Photos
from splatree.io.registry import read
from splatree.metrics.lpips import Lpips, Net
from splatree.render.evaluate import Evaluation, evaluate
from splatree.render.paths import PathOptions, flyout
from splatree.scene.options import RenderOptions, SelectOptions


@dataclass(frozen=True)
class Command:
    """Compare the cut with all leaves, view by view; with --data also both with photographs."""

    paths: Positional[tuple[Path, ...]]
    """Scene; several files or folders are read as one."""
    cameras: Path | None = None
    """cameras.json, transforms.json or a COLMAP model; None: those in --data, or else a flight away from the scene."""
    data: Path | None = None
    """Folder of photographs, named like the cameras; subfolders are searched too."""
    every: int = 1
    """Take each n-th camera only, from the first; 8 is the usual held-out split."""
    scale: float = 1.0
    """Factor on the width and height of the cameras; photographs are resized likewise."""
    lpips: Net | None = None
    """Also LPIPS by this network; needs the extra `lpips` and its weights."""
    lpips_trunk: Path | None = None
    """Weights of the classifier, from torchvision; None: where torch keeps them."""
    lpips_heads: Path | None = None
    """Weights of LPIPS version 0.1; None: from an installed package lpips or torchmetrics."""
    made: Annotated[PathOptions, arg(name="")] = PathOptions(views=8)
    select: Annotated[SelectOptions, arg(name="")] = SelectOptions()
    options: Annotated[RenderOptions, arg(name="")] = RenderOptions()
    console: Annotated[Console, arg(name="")] = Console()


@dataclass(frozen=True)
class View:
    """One view; pictures are compared clipped to 0 to 1."""

    name: str
    """Name of the camera."""
    selected: int
    """Nodes drawn from the cut."""
    pairs: int
    """N_P of the cut."""
    pixel_error: float
    """τ_R, px, as raised to meet a budget."""
    psnr_vs_leaves: float
    """Cut against all leaves, dB; infinity (null in JSON) for equal pictures."""
    ssim_vs_leaves: float | None
    """The same, structural similarity."""
    lpips_vs_leaves: float | None
    """The same, LPIPS."""
    ms: dict[str, float]
    """Wall time of each stage for the cut."""
    leaves_selected: int
    """Nodes drawn of all leaves."""
    leaves_pairs: int
    """N_P of all leaves."""
    leaves_ms: dict[str, float]
    """Wall time of each stage for all leaves."""
    psnr_vs_photo: float | None = None
    """Cut against the photograph, dB."""
    ssim_vs_photo: float | None = None
    """The same, structural similarity."""
    leaves_psnr_vs_photo: float | None = None
    """All leaves against the photograph, dB."""
    leaves_ssim_vs_photo: float | None = None
    """The same, structural similarity."""
    lpips_vs_photo: float | None = None
    """Cut against the photograph, LPIPS."""
    leaves_lpips_vs_photo: float | None = None
    """All leaves against the photograph, LPIPS."""


@dataclass(frozen=True)
class Evaluated:
    """What the views say together."""

    num_gaussians: int
    """Leaves of the scene."""
    num_nodes: int
    """All nodes."""
    levels: int
    """Largest depth + 1."""
    select: SelectOptions
    """How the cut was chosen."""
    mode: str
    """How the scene was drawn."""
    mean: dict[str, float | None]
    """Mean over the views of each number."""
    views: tuple[View, ...]
    """One entry a view."""


def run(command: Command) -> Evaluated:
    """Draw and compare each view."""
    if command.every < 1 or not command.scale > 0:
        raise InputError(f"every, scale: found {command.every}, {command.scale}, wanted at least 1, and more than 0")
    scene = read(command.paths)
    source = command.cameras or command.data
    cameras = read_cameras(source) if source else flyout(scene, command.made)
    chosen = [camera.scaled(command.scale) for camera in list(cameras)[:: command.every]]
    photos = Photos(command.data, chosen) if command.data else None
    network = Lpips(command.lpips, trunk=command.lpips_trunk, heads=command.lpips_heads) if command.lpips else None
    compared = evaluate(scene, chosen, command.options, command.select, photos=photos, lpips=network)
    views = tuple(view_of(evaluation) for evaluation in compared)
    return Evaluated(
        num_gaussians=scene.tree.num_leaves,
        num_nodes=len(scene),
        levels=scene.tree.num_levels,
        select=command.select,
        mode=command.options.mode or scene.mode,
        mean=_means(views),
        views=views,
    )


def show(evaluated: Evaluated) -> str:
    """The views as a table."""
    rows = [row_of(view) for view in evaluated.views]
    mean = ", ".join(f"{name} {value:.4g}" for name, value in evaluated.mean.items() if value is not None)
    head = f"{evaluated.num_gaussians:,} Gaussians, {evaluated.num_nodes:,} nodes, {evaluated.levels} levels, {evaluated.mode}"
    return f"{head}\n{table(rows)}\nmean: {mean}"


def view_of(e: Evaluation) -> View:
    """The numbers of one view."""
    return View(
        name=e.camera.name,
        selected=e.cut.result.counters.num_selected,
        pairs=e.cut.result.counters.num_pairs,
        pixel_error=e.cut.selection.pixel_error,
        psnr_vs_leaves=e.cut_vs_leaves.psnr,
        ssim_vs_leaves=e.cut_vs_leaves.ssim,
        lpips_vs_leaves=e.cut_vs_leaves.lpips,
        ms=e.cut.result.milliseconds,
        leaves_selected=e.leaves.result.counters.num_selected,
        leaves_pairs=e.leaves.result.counters.num_pairs,
        leaves_ms=e.leaves.result.milliseconds,
        psnr_vs_photo=e.cut_vs_photo.psnr if e.cut_vs_photo else None,
        ssim_vs_photo=e.cut_vs_photo.ssim if e.cut_vs_photo else None,
        leaves_psnr_vs_photo=e.leaves_vs_photo.psnr if e.leaves_vs_photo else None,
        leaves_ssim_vs_photo=e.leaves_vs_photo.ssim if e.leaves_vs_photo else None,
        lpips_vs_photo=e.cut_vs_photo.lpips if e.cut_vs_photo else None,
        leaves_lpips_vs_photo=e.leaves_vs_photo.lpips if e.leaves_vs_photo else None,
    )


def row_of(view: View) -> dict[str, object]:
    """One line of the table."""
    row: dict[str, object] = {
        "view": view.name,
        "nodes": view.selected,
        "of": view.leaves_selected,
        "pairs": view.pairs,
        "of ": view.leaves_pairs,
        "PSNR": view.psnr_vs_leaves,
        "SSIM": None if view.ssim_vs_leaves is None else f"{view.ssim_vs_leaves:.4f}",
    }
    if view.lpips_vs_leaves is not None:
        row["LPIPS"] = f"{view.lpips_vs_leaves:.4f}"
    row |= {f"{stage} ms": ms for stage, ms in view.ms.items()}
    if view.psnr_vs_photo is not None:
        row |= {"PSNR photo": view.psnr_vs_photo, "leaves photo": view.leaves_psnr_vs_photo}
    return row


def _means(views: Sequence[View]) -> dict[str, float | None]:
    means: dict[str, float | None] = {}
    for field in fields(View):
        values = [getattr(view, field.name) for view in views]
        numbers = [float(value) for value in values if isinstance(value, int | float)]
        if len(numbers) == len(values) and numbers:
            means[field.name] = float(np.mean(numbers))
    return means
