"""Figures of a report as PNG; the only module that needs matplotlib (extra `bench`)."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from splatree.bench.experiment import Grid, Lanes, Plot
from splatree.errors import MissingExtraError

__all__ = ["check_drawable", "draw"]

DPI = 120
"""Dots an inch of every figure."""
PANEL_INCHES = 3.2
"""Width of a picture in a grid."""
MARKERS = "os^vD<>P*Xph"
"""Of the curves in turn: colours repeat after ten."""
LETTERS_PER_INCH = 24
"""Letters of the footer in an inch."""


def check_drawable() -> None:
    """Raise before any work is done if figures could not be drawn.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("matplotlib", "bench", "drawing figures") from error


def draw(figure: Plot | Lanes | Grid, path: Path, *, footer: str) -> None:
    """Draw a figure into a PNG; the footer says what it was measured on."""
    check_drawable()
    from matplotlib.figure import Figure

    canvas = Figure(dpi=DPI, layout="constrained")
    if isinstance(figure, Plot):
        _draw_plot(figure, canvas)
    elif isinstance(figure, Lanes):
        _draw_lanes(figure, canvas)
    else:
        _draw_grid(figure, canvas)
    canvas.suptitle(figure.title, fontsize=10)
    letters = int(LETTERS_PER_INCH * canvas.get_size_inches()[0])
    canvas.supxlabel(textwrap.fill(footer, letters), fontsize=5, color="0.4")
    canvas.savefig(path, format="png")


def _draw_plot(plot: Plot, canvas: Any) -> None:
    canvas.set_size_inches(7, 4.6)
    axes = canvas.add_subplot()
    for i, curve in enumerate(plot.curves):
        style = ("--" if curve.theirs else "-") + MARKERS[i % len(MARKERS)]
        axes.plot(curve.x, curve.y, style, label=curve.label, markersize=4, linewidth=1.2)
    axes.set_xlabel(plot.x_label, fontsize=8)
    axes.set_ylabel(plot.y_label, fontsize=8)
    axes.set_xscale("log" if plot.log_x else "linear")
    axes.set_yscale("log" if plot.log_y else "linear")
    axes.tick_params(which="both", labelsize=7)
    axes.grid(visible=True, linewidth=0.3)
    axes.legend(fontsize=7)


def _draw_lanes(figure: Lanes, canvas: Any) -> None:
    canvas.set_size_inches(7, 1.2 + 0.5 * len(figure.lanes))
    axes = canvas.add_subplot()
    for i, spans in enumerate(figure.lanes.values()):
        # A white edge parts one stretch from the next.
        axes.broken_barh(list(spans), (i - 0.35, 0.7), facecolors=[f"C{i}"], edgecolors="white", linewidth=0.4)
    axes.set_yticks(range(len(figure.lanes)), list(figure.lanes), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel(figure.x_label, fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.grid(visible=True, axis="x", linewidth=0.3)


def _draw_grid(grid: Grid, canvas: Any) -> None:
    across, down = len(grid.rows[0]), len(grid.rows)
    height, width = grid.rows[0][0].image.shape[:2]
    canvas.set_size_inches(PANEL_INCHES * across, (PANEL_INCHES * height / width + 0.35) * down + 0.5)
    places = canvas.subplots(down, across, squeeze=False)
    for panels, line in zip(grid.rows, places, strict=True):
        for panel, axes in zip(panels, line, strict=True):
            axes.imshow(np.clip(panel.image, 0, 1), interpolation="nearest")
            axes.set_title(panel.caption, fontsize=7)
            axes.set_axis_off()
