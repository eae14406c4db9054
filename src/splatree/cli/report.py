"""The demo's report: one HTML page that needs nothing else, and the same pictures beside it as PNG, without loss."""

import html
import platform
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatree.bench.provenance import machine
from splatree.cli.flight import Demo, DemoView
from splatree.constants import SH_C0
from splatree.io.images import write_image
from splatree.io.replacing import replacing
from splatree.render.chart import quality_chart
from splatree.render.evaluate import Evaluation
from splatree.render.page import data_uri, filled
from splatree.render.pipeline import trace
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32
from splatree.version import program_version

ERROR_GAIN = 4.0
"""Differences are shown this many times brighter, or hardly any could be seen."""

RAMP = (
    (0.99, 0.91, 0.55),
    (0.96, 0.62, 0.36),
    (0.86, 0.34, 0.42),
    (0.58, 0.23, 0.55),
    (0.30, 0.19, 0.55),
    (0.10, 0.12, 0.35),
)
"""Colours of merged nodes from few leaves to many, RGB; equal steps in the logarithm."""

STRIP_PX = (480, 270)
"""Width and height of a picture in strip.png: each second view in a row; cut, all leaves, levels."""

LEAF_GREY = 0.82
"""Leaves themselves are this grey."""


def write_report(demo: Demo, scene: Scene, evaluations: Sequence[Evaluation]) -> None:
    """Write the pictures and the page into the folder of ``demo.report``."""
    folder = demo.report.parent
    coloured = with_level_colors(scene)
    cards, strip = [], []
    for i, (view, e) in enumerate(zip(demo.views, evaluations, strict=True)):
        same_cut = replace(demo.select, pixel_error=view.pixel_error, budget=None, quality=None)
        levels = trace(coloured, e.camera, select=same_cut).result.image
        error = ERROR_GAIN * np.abs(np.clip(e.cut.result.image, 0, 1) - np.clip(e.leaves.result.image, 0, 1))
        pictures = {"cut": e.cut.result.image, "leaves": e.leaves.result.image, "levels": levels, "error": error}
        for name, image in pictures.items():
            write_image(image, folder / f"{i}_{name}.png", force=True)
        y, x = _window(e.leaves.result.alpha)
        crops = {name: image[y, x] for name, image in pictures.items()}
        strip.append(np.concatenate([_resized(crops[name], STRIP_PX) for name in ("cut", "leaves", "levels")], axis=1))
        sources = {name: data_uri(crop) for name, crop in crops.items()}
        enlarged = e.camera.width / (x.stop - x.start)
        cards.append(filled("report_view.html", enlarged=_enlarged(enlarged), **sources, **_words(view)))
    write_image(np.concatenate(strip[1::2] or strip), folder / "strip.png", force=True)
    page = filled(
        "report.html",
        gaussians=f"{demo.num_gaussians:,}",
        nodes=f"{demo.num_nodes:,}",
        levels=str(demo.levels),
        mode=demo.mode,
        pixel_error=f"{demo.select.pixel_error:g}",
        build_s=f"{demo.seconds['build']:.1f}",
        gain=f"{ERROR_GAIN:g}",
        cards="\n".join(cards),
        table=_table(demo.views),
        chart=_chart(demo.views),
        legend=_legend(scene),
        depths=" · ".join(f"{n:,}" for n in demo.nodes_per_depth),
        machine=html.escape(f"splatree {program_version()} · {machine()} · Python {platform.python_version()}"),
        credit=html.escape(demo.credit),
    )
    with replacing(demo.report, force=True) as temporary:
        temporary.write_text(page, encoding="utf-8")


def with_level_colors(scene: Scene) -> Scene:
    """The scene with each merged node coloured by the number of leaves that it stands for, and leaves grey."""
    num_leaves = leaves_per_node(scene)
    place = (
        np.log2(np.maximum(num_leaves, 1))
        / max(1.0, float(np.log2(max(2, num_leaves.max(initial=2)))))
        * (len(RAMP) - 1)
    )
    steps = np.arange(len(RAMP))
    colors = np.stack([np.interp(place, steps, [color[c] for color in RAMP]) for c in range(3)], axis=-1)
    colors[scene.tree.is_leaf] = LEAF_GREY
    sh = ((colors - 0.5) / SH_C0).astype(np.float32)[:, None]
    return replace(scene, gaussians=replace(scene.gaussians, sh=np.ascontiguousarray(sh)))


def leaves_per_node(scene: Scene) -> Array:
    """Leaves below each row, itself included: subtrees are ranges."""
    before = np.concatenate([[0], np.cumsum(scene.tree.is_leaf)])
    return np.asarray(before[scene.tree.subtree_end] - before[:-1])


def _window(alpha: Float32[Array, "h w"]) -> tuple[slice, slice]:
    """The part of a picture that holds the scene, in the picture's own proportions and at least an eighth of its width."""
    height, width = alpha.shape
    ys, xs = np.nonzero(alpha > 0.05)
    if len(ys) == 0:
        return slice(0, height), slice(0, width)
    low, high = (np.array([np.quantile(ys, share), np.quantile(xs, share)]) for share in (0.001, 0.999))
    full = np.array([height, width])
    share = float(np.clip(1.1 * np.max((high - low) / full), 0.125, 1.0))
    h, w = np.rint(share * full).astype(int)
    top, left = np.clip((low + high - (h, w)) / 2, 0, full - (h, w)).astype(int)
    return slice(top, top + h), slice(left, left + w)


def _resized(image: Float32[Array, "h w 3"], size: tuple[int, int]) -> Array:
    from PIL import Image

    return np.asarray(Image.fromarray(_bytes(image)).resize(size, Image.Resampling.LANCZOS), np.float32) / 255


def _bytes(image: Float32[Array, "h w 3"]) -> Array:
    return np.asarray(np.rint(255 * np.clip(image, 0, 1)), np.uint8)


def _enlarged(factor: float) -> str:
    return f", shown {factor:.1f} × enlarged" if factor > 1.05 else ""


def _chart(views: Sequence[DemoView]) -> str:
    """Quality over nodes drawn, one line a distance."""
    lines = {f"{v.distance:,.0f}": [(max(1, nodes), quality) for _, nodes, quality in v.curve] for v in views}
    return quality_chart(lines, "PSNR over nodes drawn")


def _words(view: DemoView) -> dict[str, str]:
    return {
        "distance": f"{view.distance:,.0f}",
        "selected": f"{view.selected:,}",
        "leaves_selected": f"{view.leaves_selected:,}",
        "share": f"{100 * view.selected / max(1, view.leaves_selected):.0f}",
        "psnr": f"{view.psnr_vs_leaves:.1f}",
    }


def _table(views: Sequence[DemoView]) -> str:
    stages = list(views[0].ms)
    head = [
        "distance",
        "nodes drawn",
        "all leaves",
        "share",
        "N<sub>P</sub>",
        "N<sub>P</sub> leaves",
        "PSNR",
        "PSNR covered",
        "SSIM",
    ]
    head += [f"{stage} ms" for stage in stages] + ["total ms", "total ms leaves"]
    rows = ["<tr>" + "".join(f"<th>{cell}</th>" for cell in head) + "</tr>"]
    for view in views:
        cells = [
            f"{view.distance:,.0f}",
            f"{view.selected:,}",
            f"{view.leaves_selected:,}",
            f"{100 * view.selected / max(1, view.leaves_selected):.0f} %",
            f"{view.pairs:,}",
            f"{view.leaves_pairs:,}",
            f"{view.psnr_vs_leaves:.1f}",
            f"{view.psnr_where_covered:.1f}",
            "" if view.ssim_vs_leaves is None else f"{view.ssim_vs_leaves:.4f}",
            *(f"{view.ms[stage]:.1f}" for stage in stages),
            f"{sum(view.ms.values()):.0f}",
            f"{sum(view.leaves_ms.values()):.0f}",
        ]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return "\n".join(rows)


def _legend(scene: Scene) -> str:
    top = max(2, int(leaves_per_node(scene).max(initial=2)))
    stops = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*(255 * c for c in color)) for color in RAMP)
    grey = f"{255 * LEAF_GREY:.0f}"
    return (
        f'<span class="key" style="background: rgb({grey} {grey} {grey})"></span> a leaf &nbsp; 2 leaves '
        f'<span class="key ramp" style="background: linear-gradient(to right, {stops})"></span> {top:,} leaves'
    )
