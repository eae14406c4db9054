"""What reading and writing each format costs, against splat-transform on the same files in the same run.

``python benchmarks/formats.py [--count 1000000] [--formats ply spz]`` needs the shared city and the command
``splat-transform`` (npm: @playcanvas/splat-transform; --peer names it). The first ``count`` Gaussians of the city, degree 3,
are written as a .ply; each format is then written from that .ply and read back into a .ply, by either program in a process of
its own, to files that are not there yet. Cost is processor seconds of the whole command, the cheapest of ``repeat`` runs that
take turns, less what the same program takes to convert ten Gaussians from .ply to .ply (printed as rows of their own): it starts,
loads its parts and stops, the cheapest of three times as many runs, as it is taken off all rows. Modules of Python are compiled
once beforehand, as they are in an installation. Ratios are the peer's cost over ours. Memory is the peak of the process, start
included, over the sum of the sizes of input and output.

The peer writes no .ksplat, .hier, .rad or .splatree; it reads our .ksplat. Its SOG with harmonics needs a GPU (100,000 Gaussians
were not done after an hour of a processor), so both write SOG without harmonics here, and a row of ours alone has them.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness import DATA, Cost, measure, save, table
from splatree.io.registry import formats

CITY = DATA / "trained" / "semarang_city"
OURS = (sys.executable, "-c", "import sys; from splatree.cli.main import main; sys.exit(main())")

PREPARE = """
import sys, numpy, splatree
source, target, count = sys.argv[1:]
scene = splatree.read(source)
few = scene.gaussians.take(numpy.arange(int(count)))
splatree.write(splatree.Scene.flat(few, mode=scene.mode), target)
"""


@dataclass(frozen=True)
class Case:
    """A format as both programs are asked for it."""

    suffix: str
    """Ending of the file."""
    ours: tuple[str, ...] = ()
    """Options of ours when writing."""
    peer: tuple[str, ...] | None = None
    """Options of the peer when writing; None: it does not write this."""
    peer_reads: bool = True
    """Whether the peer reads it."""
    note: str = ""
    """What distinguishes the row."""


CASES = (
    Case(".ply", peer=()),
    Case(".compressed.ply", peer=()),
    Case(".splat", peer=()),
    Case(".spz", peer=()),
    Case(".glb", peer=(), peer_reads=False),
    Case(".sog", ours=("--sh-degree", "0"), peer=("-H", "0"), note="SH 0"),
    Case(".sog"),
    Case(".ksplat"),
    Case(".hier", peer_reads=False),
    Case(".rad", peer_reads=False),
    Case(".splatree", peer_reads=False),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--formats", nargs="*", default=None, help="endings to measure, without the dot (default: all)")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--peer", default="splat-transform", help="command of splat-transform")
    parser.add_argument("--folder", type=Path, default=None, help="where the files go (default: the system's)")
    arguments = parser.parse_args()
    if not CITY.is_dir():
        raise SystemExit(f"needs the city at {CITY}")
    peer = shutil.which(arguments.peer)
    if peer is None:
        raise SystemExit("needs splat-transform: npm install --global @playcanvas/splat-transform, or --peer")
    written = {suffix for f in formats() if f.is_written for suffix in f.suffixes}
    cases = [c for c in CASES if c.suffix in written]
    if arguments.formats:
        cases = [c for c in cases if c.suffix[1:] in arguments.formats]

    with tempfile.TemporaryDirectory(dir=arguments.folder) as temporary:
        folder = Path(temporary)
        # As after an installation, whatever the shell says: a source tree may not be written to.
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
        # In a process of its own: a child's peak memory begins with that of its parent.
        for name, count in (("scene.ply", arguments.count), ("ten.ply", 10)):
            subprocess.run([sys.executable, "-c", PREPARE, CITY, folder / name, str(count)], check=True)
        ten, out = folder / "ten.ply", folder / "out.ply"
        start_ours, start_peer = [*OURS, "convert", ten, out, "-q"], [peer, "-q", ten, out]
        starts = compare(start_ours, start_peer, (out, out), 3 * arguments.repeat)
        rows: list[dict[str, Any]] = [start_row("splatree", starts[0]), start_row("splat-transform", starts[1])]
        for case in cases:
            rows += rows_of(case, folder, peer, starts, arguments.repeat)
    print(table(rows))
    save(
        "formats",
        rows,
        about=f"Writing each format from a .ply of {arguments.count:,} Gaussians of degree 3, and reading it back into one, "
        "against splat-transform 3.7: processor seconds less those of starting the program, and peak memory over the sizes of "
        "input and output.",
    )


def rows_of(case: Case, folder: Path, peer: str, starts: tuple[Cost, Cost | None], repeat: int) -> list[dict[str, Any]]:
    """Write, read, and both together."""
    source, ours, theirs, back = (
        folder / name for name in ("scene.ply", f"o{case.suffix}", f"t{case.suffix}", "back.ply")
    )
    write_peer = None if case.peer is None else [peer, "-w", "-q", source, *case.peer, theirs]
    write = compare([*OURS, "convert", source, ours, "--force", "-q", *case.ours], write_peer, (ours, theirs), repeat)
    sizes = {"write": source.stat().st_size + ours.stat().st_size}
    # Each reads its own file: those of one format differ in how hard they were compressed. The peer reads ours if it writes none.
    readable = theirs if case.peer is not None else ours
    read_peer = [peer, "-w", "-q", readable, back] if case.peer_reads else None
    read = compare([*OURS, "convert", ours, back, "--force", "-q"], read_peer, (back, back), repeat)
    sizes["read"] = ours.stat().st_size + back.stat().st_size
    label = f"{case.suffix} {case.note}".strip()
    rows = [row(f"{name} {label}", cost, starts, sizes[name]) for name, cost in (("write", write), ("read", read))]
    if write[1] is not None and read[1] is not None:
        both = sum(w["ours CPU s"] for w in rows), sum(w["peer CPU s"] for w in rows)
        rows.append({"work": f"both {label}", "ours CPU s": both[0], "peer CPU s": both[1], "ratio": both[1] / both[0]})
    for path in (ours, theirs, back):
        path.unlink(missing_ok=True)
    return rows


def compare(
    ours: list[Any], peer: list[Any] | None, targets: tuple[Path, ...], repeat: int
) -> tuple[Cost, Cost | None]:
    """The cheapest runs of either, by processor seconds, taking turns; each writes its own of ``targets`` anew."""
    best: list[Cost | None] = [None, None]
    for _ in range(repeat):
        for i, command in enumerate((ours, peer)):
            if command is None:
                continue
            for target in targets[i : i + 1]:
                target.unlink(missing_ok=True)
            cost = measure(command)
            found = best[i]
            best[i] = cost if found is None or cost.cpu_s < found.cpu_s else found
    assert best[0] is not None
    return best[0], best[1]


def row(name: str, costs: tuple[Cost, Cost | None], starts: tuple[Cost, Cost | None], num_bytes: int) -> dict[str, Any]:
    """One line of the table."""
    ours, peer = costs
    mine = max(ours.cpu_s - starts[0].cpu_s, 1e-3)
    line = {
        "work": name,
        "MB": round(num_bytes / 1e6),
        "ours CPU s": mine,
        "ours memory": ours.peak_bytes / num_bytes,
    }
    if peer is not None and starts[1] is not None:
        theirs = max(peer.cpu_s - starts[1].cpu_s, 1e-3)
        line |= {"peer CPU s": theirs, "peer memory": peer.peak_bytes / num_bytes, "ratio": theirs / mine}
    return line


def start_row(name: str, cost: Cost | None) -> dict[str, Any]:
    """What a program takes to do nothing; it is taken off the other rows."""
    assert cost is not None
    return {"work": f"start {name}", ("ours" if name == "splatree" else "peer") + " CPU s": cost.cpu_s}


if __name__ == "__main__":
    main()
