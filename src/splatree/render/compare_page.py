"""A comparison of two scenes as a folder: an HTML page that needs nothing else, and its pictures beside it as PNG."""

import html
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from splatree.errors import InputError, OutputError
from splatree.io.images import write_image
from splatree.io.replacing import check_free_in, replacing
from splatree.render.compare import ComparedView, Difference, summary_of
from splatree.render.page import data_uri, filled
from splatree.scene.arguments import checked
from splatree.shapes import Array, Float32

__all__ = [
    "PAGE",
    "Comparison",
    "card_of",
    "check_comparison_folder",
    "decibels",
    "error_colors",
    "number_cards",
    "write_comparison",
]

PAGE: Final = "report.html"
"""Name of the page in its folder."""

WHITE_AT: Final = 0.5
"""FLIP that is shown white; what is twice as bad cannot be told apart by then."""

RAMP: Final = (
    (0.0, 0.0, 0.02),
    (0.23, 0.06, 0.44),
    (0.55, 0.16, 0.51),
    (0.87, 0.29, 0.41),
    (0.99, 0.62, 0.43),
    (1.0, 1.0, 0.95),
)
"""Colours of errors, RGB, at equal steps from 0 to WHITE_AT."""


@dataclass(frozen=True)
class Comparison:
    """What a comparison of two scenes found.

    Example:
        >>> found = st.write_comparison(st.compare(scene, st.read("city.ply"), cameras))
        >>> found.all.num_pixels == 10 * 64 * 36
        True
    """

    all: Difference
    """All views together."""
    worst: str
    """Name of the view with the largest FLIP."""
    views: tuple[Difference, ...]
    """One entry a view, in order."""
    report: Path | None = None
    """The page; None if none was written."""
    notes: tuple[str, ...] = ()
    """What puts the numbers in doubt, a sentence each."""


@checked
def write_comparison(
    views: Iterable[ComparedView],
    folder: str | os.PathLike[str] | None = None,
    *,
    title: str = "How much was lost",
    about: str = "",
    force: bool = False,
) -> Comparison:
    """Write the pictures and the page of a comparison into a folder.

    For each view NAME_side_by_side.png (reference, scene, errors) and NAME_error.png are written, and a page report.html.

    Args:
        views: from `compare`. Each view is let go once its pictures are written.
        folder: where to write, made if it is not there; None: nothing is written.
        title: headline of the page.
        about: a sentence below the headline, such as the names of both files.
        force: replace a page that is there.

    Returns:
        All views together, and each view.

    Raises:
        InputError: there is no view.
        OutputError: the page exists and ``force`` is not set, or the folder cannot be written.

    Example:
        >>> views = st.compare(scene, st.read("city.ply"), [camera.scaled(2)])
        >>> st.write_comparison(views, "lost").report.name
        'report.html'
    """
    place = None if folder is None else Path(folder)
    if place is not None:
        check_comparison_folder(place, force=force)
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{place}: cannot be made a folder ({error.strerror})") from error
    differences, cards = [], []
    for i, view in enumerate(views):
        differences.append(view.difference)
        if place is None:
            continue
        name = re.sub(r"[^\w.-]+", "_", Path(view.camera.name).stem) or f"{i:04d}"
        colors = error_colors(view.errors)
        side_by_side = np.concatenate([view.reference, view.image, colors], axis=1)
        write_image(side_by_side, place / f"{name}_side_by_side.png", force=True)
        write_image(colors, place / f"{name}_error.png", force=True)
        cards.append((view.difference.flip, card_of(view, colors)))
    if not differences:
        raise InputError("write_comparison: found no view, wanted at least one")
    together = summary_of(differences)
    worst = max(differences, key=lambda difference: difference.flip).name
    if place is None:
        return Comparison(together, worst, tuple(differences))
    body = filled(
        "comparison.html",
        table=_table([*differences, together]),
        cards="\n".join(card for _, card in sorted(cards, key=lambda card: -card[0])),
    )
    numbers = number_cards(_numbers(together, worst))
    text = filled("page.html", title=html.escape(title), about=html.escape(about), numbers=numbers, body=body)
    with replacing(place / PAGE, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Comparison(together, worst, tuple(differences), place / PAGE)


def check_comparison_folder(folder: Path, *, force: bool) -> None:
    """Refuse a folder that no comparison can be written to, before any work is done for it; nothing is made yet.

    Raises:
        OutputError: it cannot be made, or holds a page already and ``force`` is not set.
    """
    check_free_in(folder, [PAGE], force=force)


def error_colors(errors: Float32[Array, "h w"]) -> Float32[Array, "h w 3"]:
    """Errors as colours, from black through red to white at WHITE_AT."""
    place = np.clip(errors / WHITE_AT, 0, 1) * (len(RAMP) - 1)
    channels = [np.interp(place, np.arange(len(RAMP)), [color[c] for color in RAMP]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def decibels(value: float | None) -> str:
    """31.42, or "equal" for equal pictures."""
    if value is None:
        return ""
    return "equal" if math.isinf(value) else f"{value:.2f}"


def number_cards(numbers: Mapping[str, str]) -> str:
    """The numbers at the head of a page, by what they are; empty ones are left out."""
    return "".join(
        f"<div><b>{html.escape(value)}</b>{html.escape(name)}</div>" for name, value in numbers.items() if value
    )


def _numbers(together: Difference, worst: str) -> dict[str, str]:
    return {
        "PSNR": decibels(together.psnr) + ("" if math.isinf(together.psnr) else " dB"),
        "PSNR covered": decibels(together.psnr_covered),
        "SSIM": "" if together.ssim is None else f"{together.ssim:.4f}",
        "FLIP": f"{together.flip:.4f}",
        "worst view": worst,
    }


def _table(differences: Sequence[Difference]) -> str:
    head = ("view", "drawn", "of the reference", "PSNR", "PSNR covered", "SSIM", "FLIP")
    rows = ["<tr>" + "".join(f"<th>{cell}</th>" for cell in head) + "</tr>"]
    for d in differences:
        cells = (
            html.escape(d.name),
            f"{d.num_drawn:,}",
            f"{d.num_drawn_reference:,}",
            decibels(d.psnr),
            decibels(d.psnr_covered),
            "" if d.ssim is None else f"{d.ssim:.4f}",
            f"{d.flip:.4f}",
        )
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return "\n".join(rows)


def card_of(view: ComparedView, colors: Array) -> str:
    """A view in HTML: both pictures with a slider between them, and the errors."""
    d = view.difference
    return filled(
        "comparison_view.html",
        name=html.escape(d.name),
        words=f"PSNR {decibels(d.psnr)}, FLIP {d.flip:.4f}",
        white=f"{WHITE_AT:g}",
        image=data_uri(view.image),
        reference=data_uri(view.reference),
        errors=data_uri(colors),
    )
