"""What was lost: of what a verb wrote beside what it read (`--report`), or of one scene beside another (`eval --reference`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splatree.cli.console import UsageError, table
from splatree.errors import InputError
from splatree.io.joined import relative_to
from splatree.io.reading import read
from splatree.kernels.devices import DeviceName
from splatree.render.compare import compare
from splatree.render.compare_page import Comparison, check_comparison_folder, decibels, write_comparison
from splatree.render.overlap import place_hint
from splatree.scene.cameras import Camera
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.origin import NO_ORIGIN
from splatree.scene.scene import Scene

__all__ = ["Drawing", "Reporting", "compared", "in_words", "read_back"]


@dataclass(frozen=True)
class Reporting:
    """Whether to say what was lost."""

    report: Path | None = None
    """Also compare what is written with what was read: a folder for report.html and its pictures, with PSNR, SSIM and FLIP."""

    def check(self, *, force: bool) -> None:
        """Refuse a folder that cannot be written, before any work is done."""
        if self.report is not None:
            if self.report.suffix.lower() in (".html", ".htm", ".json", ".png"):
                raise UsageError(f"report: found {self.report}, wanted a folder, in which report.html will lie")
            check_comparison_folder(self.report, force=force)


@dataclass(frozen=True)
class Drawing:
    """How the views of a comparison are drawn."""

    options: RenderOptions | None = None
    """Both scenes."""
    select: SelectOptions | None = None
    """The nodes of the scene that is judged."""
    device: DeviceName = "cpu"
    """Where."""


def compared(
    scene: Scene,
    reference: Scene,
    cameras: Sequence[Camera] | None,
    report: Path | None,
    *,
    about: str,
    force: bool,
    drawing: Drawing | None = None,
) -> Comparison:
    """Draw both scenes and compare them, and write the page if a folder is named."""
    how, origins = drawing or Drawing(), (scene.source.origin, reference.source.origin)
    if NO_ORIGIN not in origins:  # a file that lost its origin is relative to that of the other
        scene = replace(scene, gaussians=relative_to(scene.gaussians, *origins), blocks=None, clusters=None)
    views = compare(scene, reference, cameras, options=how.options, select=how.select, device=how.device)
    found = write_comparison(views, report, about=about, force=force)
    hint = place_hint(scene, reference)
    return replace(found, notes=(hint,)) if hint else found


def read_back(
    output: Path, reference: Scene, reporting: Reporting, *, made_from: str, force: bool
) -> Comparison | None:
    """Compare a file that was written with the scene that it was made from; None without --report."""
    if reporting.report is None:
        return None
    scene = read(output)
    if not len(scene) or not len(reference):
        raise InputError(
            f"report: found no Gaussians in {output if not len(scene) else made_from}, so there is nothing to compare"
        )
    about = f"{output} ({len(scene):,} rows) beside {made_from} ({len(reference):,} rows), drawn from the same views"
    return compared(scene, reference, None, reporting.report, about=about, force=force)


def in_words(comparison: Comparison, *, views: bool = False) -> list[str]:
    """The numbers of all views together, and with ``views`` a table of each."""
    rows: list[dict[str, Any]] = [
        {
            "view": d.name,
            "drawn": d.num_drawn,
            "of": d.num_drawn_reference,
            "PSNR": decibels(d.psnr),
            "covered": decibels(d.psnr_covered),
            "SSIM": "" if d.ssim is None else f"{d.ssim:.4f}",
            "FLIP": f"{d.flip:.4f}",
        }
        for d in (*comparison.views, comparison.all)
    ]
    d = comparison.all
    ssim = "" if d.ssim is None else f", SSIM {d.ssim:.4f}"
    covered = "" if d.psnr_covered is None else f" ({decibels(d.psnr_covered)} where the scene covers the picture)"
    lines = [table(rows)] if views else []
    lines.append(
        f"against the reference: PSNR {decibels(d.psnr)}{covered}{ssim}, FLIP {d.flip:.4f}; worst view {comparison.worst}"
    )
    lines += [f"note: {note}" for note in comparison.notes]
    return [*lines, *([f"wrote {comparison.report}"] if comparison.report else [])]
