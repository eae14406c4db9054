"""A report as files: ``<experiment>.json`` with everything, a CSV for each table, a PNG for each figure."""

import csv
import json
import math
from pathlib import Path
from typing import Any

from splatree.bench.experiment import Report, Table
from splatree.errors import OutputError
from splatree.io.replacing import replacing

__all__ = ["write_report"]


def write_report(report: Report, folder: Path, *, force: bool = False) -> tuple[Path, ...]:
    """Write the report into the folder, which is made if it is missing; returns the files.

    Raises:
        OutputError: a file exists and ``force`` is not set, or cannot be written.
        MissingExtraError: there are figures, and matplotlib is not installed.
    """
    names = {"json": [report.name], "csv": [t.name for t in report.tables], "png": [f.name for f in report.figures]}
    targets = {suffix: [folder / f"{name}.{suffix}" for name in of] for suffix, of in names.items()}
    existing = [path for paths in targets.values() for path in paths if path.exists()]
    if existing and not force:
        raise OutputError(f"{existing[0]}: exists already; choose another folder or use --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder for results ({error.strerror})") from error
    for table, path in zip(report.tables, targets["csv"], strict=True):
        _write_csv(table, path, force)
    if report.figures:
        from splatree.bench.draw import draw

        for figure, path in zip(report.figures, targets["png"], strict=True):
            with replacing(path, force=force) as temporary:
                draw(figure, temporary, footer=_footer(report))
    with replacing(targets["json"][0], force=force) as temporary:
        text = json.dumps(_content(report), indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    return tuple(path for paths in targets.values() for path in paths)


def _content(report: Report) -> dict[str, Any]:
    tables = [
        {
            "name": table.name,
            "title": table.title,
            "source": table.source,
            "notes": list(table.notes),
            "rows": [{key: _plain(value) for key, value in row.items()} for row in table.rows],
        }
        for table in report.tables
    ]
    return {"name": report.name, "title": report.title, "about": dict(report.about), "tables": tables}


def _write_csv(table: Table, path: Path, force: bool) -> None:
    columns = list(dict.fromkeys(key for row in table.rows for key in row))
    with replacing(path, force=force) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows({key: _plain(value) for key, value in row.items()} for row in table.rows)


def _plain(value: object) -> object:
    """What JSON and CSV have; infinity and NaN, which JSON has not, become nothing."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _footer(report: Report) -> str:
    return " · ".join(report.about[key] for key in ("scene", "cameras", "machine", "version") if key in report.about)
