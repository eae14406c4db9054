"""The report of a stream as an HTML page that needs nothing else: chart, tables, and a picture of the worst view."""

import html
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from statistics import median

from splatree.errors import InputError
from splatree.io.local import local_inputs
from splatree.io.replacing import replacing
from splatree.render.chart import quality_chart
from splatree.render.compare import compared
from splatree.render.compare_page import card_of, decibels, error_colors, number_cards
from splatree.render.page import filled
from splatree.render.pipeline import render
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.scene import Scene
from splatree.stream.report import EVERY_ROW, StreamReport, ViewQuality, named_views, viewers_of
from splatree.stream.result import Streamed

__all__ = ["write_stream_report"]


@checked
def write_stream_report(
    report: StreamReport,
    scene: Scene,
    written: Streamed,
    path: str | os.PathLike[str],
    cameras: Iterable[Camera] | None = None,
    *,
    force: bool = False,
) -> None:
    """Write the report of a stream as an HTML page.

    Args:
        report: from `report_stream`.
        scene: the scene that the report was made with.
        written: the stream that the report was made with; its files are drawn once more in the worst view.
        path: the page.
        cameras: the views that the report was made with; None: near, middle and far.
        force: replace a page that is there.

    Raises:
        InputError: the report has no views, or those of other cameras.
        OutputError: the page exists and ``force`` is not set, or it cannot be written.

    Example:
        >>> written = st.stream(scene, "city_stream")
        >>> report = st.report_stream(scene, written, [camera.scaled(2)], budgets=[100])
        >>> st.write_stream_report(report, scene, written, "city.html", [camera.scaled(2)])
    """
    if not report.views:
        raise InputError("write_stream_report: found a report without views, wanted at least one")
    worst = min(report.views, key=lambda view: view.psnr_db)
    numbers = {
        "whole stream": _megabytes(written.bytes),
        "chunks": f"{written.num_chunks:,}",
        "first picture": _megabytes(written.levels[-1].bytes) if written.format == "sog" else "",
        "worst view": f"{worst.view}, {decibels(worst.psnr_db)} dB",
    }
    body = filled(
        "stream_report.html",
        chart=_chart(report.views),
        views=_table(_VIEW_HEAD, map(_view_row, report.views)),
        levels=_levels(report) if report.levels else "",
        worst=_card(scene, written, worst, cameras),
    )
    name = html.escape(written.output.name)
    about = f"{name}: a stream of {scene.tree.num_leaves:,} Gaussians for {' and '.join(_viewers(report))}, judged view by view"
    page = filled("page.html", title=f"How {name} looks", about=about, numbers=number_cards(numbers), body=body)
    with replacing(path, force=force) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _viewers(report: StreamReport) -> list[str]:
    return [_NAMES[viewer] for viewer in dict.fromkeys(view.viewer for view in report.views)]


_NAMES = {"playcanvas": "PlayCanvas", "playcanvas 2.22": "PlayCanvas 2.22", "spark": "Spark", "cesium": "CesiumJS"}
_VIEW_HEAD = ("view", "viewer", "setting", "nodes", "loaded", "PSNR", "exact cut")


def _chart(views: Sequence[ViewQuality]) -> str:
    lines: dict[str, list[tuple[float, float]]] = {}
    several = len({view.viewer for view in views}) > 1
    for view in views:
        name = f"{view.view}, {view.viewer}" if several else view.view
        lines.setdefault(name, []).append((max(view.bytes, 1) / 1e6, view.psnr_db))
    return quality_chart(lines, "PSNR over megabytes loaded")


def _view_row(view: ViewQuality) -> tuple[str, ...]:
    setting = f"{view.setting:g} px" if view.viewer == "cesium" else f"{view.setting:,.0f}"
    quality = decibels(view.psnr_db), decibels(view.exact_psnr_db)
    return view.view, _NAMES[view.viewer], setting, f"{view.num_nodes:,}", _megabytes(view.bytes), *quality


def _levels(report: StreamReport) -> str:
    rows = []
    for level in report.levels:
        found = [quality for chunk in report.chunks if (quality := chunk.psnr_db[level.level]) is not None]
        chunks = (decibels(median(found)), decibels(min(found))) if found else ("", "")
        own = f"{level.level}", f"{level.num_nodes:,}", _megabytes(level.bytes)
        rows.append((*own, decibels(level.psnr_db), f"{level.ssim:.4f}", *chunks))
    head = ("level", "nodes", "size", "PSNR", "SSIM", "in chunks, median", "worst chunk")
    every = [
        (
            f"{chunk.chunk}",
            *(f"{n:,}" for n in chunk.num_nodes),
            *(decibels(quality) for quality in chunk.psnr_db[1:]),
        )
        for chunk in report.chunks
    ]
    levels = range(len(report.levels))
    every_head = ("chunk", *(f"level {level}" for level in levels), *(f"dB, {level}" for level in levels[1:]))
    view = html.escape(report.levels[0].view)
    return filled("stream_levels.html", levels=_table(head, rows), view=view, chunks=_table(every_head, every))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["".join(f"<th>{html.escape(cell)}</th>" for cell in head)]
    lines += ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows]
    return "\n".join(f"<tr>{line}</tr>" for line in lines)


def _card(scene: Scene, written: Streamed, worst: ViewQuality, cameras: Iterable[Camera] | None) -> str:
    """What the viewer draws in a view beside all leaves."""
    camera = named_views(scene, cameras).get(worst.view)
    if camera is None:
        raise InputError(
            f"cameras: found no view {worst.view!r}, which the report has; wanted the report's own cameras"
        )
    with local_inputs([written.output]) as local:
        loaded = viewers_of(scene, replace(written, output=local.paths[0]))[worst.viewer](camera, worst.setting)
    view = compared(replace(camera, name=worst.view), loaded.shown, render(scene, camera, select=EVERY_ROW))
    view = replace(view, difference=replace(view.difference, name=f"{worst.view}, {_view_row(worst)[2]}"))
    return card_of(view, error_colors(view.errors))


def _megabytes(num_bytes: int) -> str:
    return f"{num_bytes / 1e6:.2f} MB"
