"""The tables and figures of FilterGS on a real scene: `splatree bench table1 ... fig7`, kept for RESULTS.md.

``python benchmarks/filtergs.py [scene] [--cameras FILE] [--views N] [--size PX] [--frames N] [--only table1 fig6]``; without a
scene, the bundled piece of a city. The measured tables are kept, the paper's own are not: `splatree bench` prints both.
"""

import argparse
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path

from harness import save, table
from splatree.bench.experiment import MEASURED, Report
from splatree.bench.subject import SubjectOptions
from splatree.cli.main import commands_of

EXPERIMENTS = [name for name in commands_of("bench") if name.startswith(("table", "fig"))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, nargs="*")
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--size", type=int, default=640)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=EXPERIMENTS, default=EXPERIMENTS)
    given = parser.parse_args()
    subject = SubjectOptions(tuple(given.scene), given.cameras, views=given.views, size=given.size)
    for name in given.only:
        keep(experiment(name, subject, given.frames))


def experiment(name: str, subject: SubjectOptions, frames: int) -> Report:
    module = import_module(f"splatree.bench.{name}")
    options = replace(module.Options(), subject=subject)
    if any(field.name == "frames" for field in fields(options)):
        options = replace(options, frames=frames)
    return module.run(options)


def keep(report: Report) -> None:
    about = "; ".join(f"{key}: {report.about[key]}" for key in ("scene", "cameras", "compared with", "rules"))
    for one in report.tables:
        if one.source == MEASURED:
            print(f"\n{one.title}\n{about}\n{table(one.rows)}")
            save(f"filtergs_{one.name}", one.rows, about=f"{one.title}. {about}. {' '.join(one.notes)}".strip())


if __name__ == "__main__":
    main()
