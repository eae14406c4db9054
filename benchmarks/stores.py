"""What each verb takes of a scene on disk, a folder of parts or one .splatree: memory that no file backs, and processor time.

``python benchmarks/stores.py [--chunks 1 3] [--only "to .splatree"] [--folder /tmp]`` needs the shared city. Each verb runs on
fewer and on more chunks of it, as a command of its own. `render` draws the near view of the made views, 1280 × 720; the start of
the program and the writing of the picture are included. Memory is measured as in `scale.py`; what it grows by for a Gaussian more
says whether a scene may be larger than memory. With ``--store`` and ``--file``, the first picture is also measured on a folder
and a file that are there.
"""

import argparse
import re
import tempfile
from pathlib import Path

import splatree as st
from harness import DATA, save, table
from scale import run

NEAR = ("--cameras", DATA / "cameras" / "semarang_city_made_views.json", "--view", "15")
VERBS = {
    "info": ("info",),
    "check": ("check",),
    "render, near view": ("render", "-o", "near.png", *NEAR),
    "render, near view, 100M": ("render", "-o", "near.png", *NEAR, "--max-memory", "100M"),
    "convert to .splatree": ("convert", "-o", "one.splatree"),
    "convert to .ply": ("convert", "-o", "leaves.ply"),
    "convert to .spz": ("convert", "-o", "leaves.spz"),
    "convert to .splatree, moved": ("convert", "-o", "moved.splatree", "--translate", "1", "2", "3"),
    "convert to .splatree, cropped": ("convert", "-o", "cropped.splatree", "--crop-sphere", "0", "0", "0", "100"),
    "clean to .splatree": ("clean", "-o", "clean.splatree", "--floaters"),
    "stream": ("stream", "-o", "web"),
    "stream, chunks of 4,096": ("stream", "-o", "web", "--chunk-leaves", "4096"),
    "stream, chunks of 4,096, 250M": ("stream", "-o", "web", "--chunk-leaves", "4096", "--max-memory", "250M"),
}
"""Words of each verb; outputs lie in the folder. Chunks of a stream grow with the scene, and so does what a file of them takes;
files of chunks of 4,096 Gaussians are full with fewer chunks of the city as with more."""

PROCESS = 3
"""Pictures of which the cheapest counts: other work shares the processor's caches."""


def words_of(verb: str, scene: Path, folder: Path) -> list[object]:
    """A command on a scene."""
    name, *rest = VERBS[verb]
    at = rest.index("-o") + 1 if "-o" in rest else None
    words = [folder / str(word) if i == at else word for i, word in enumerate(rest)]
    return [name, scene, *words, "-q", *(["--force"] if at is not None else [])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, nargs=2, default=[1, 3], help="chunks of the city, fewer and more")
    parser.add_argument("--only", help="only verbs that have this in their line, kept in a file of their own")
    parser.add_argument("--store", type=Path, help="a folder of parts of the whole city")
    parser.add_argument("--file", type=Path, help="the same as one .splatree")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())
    rows = []
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder, counts, scenes = Path(name), [], []
        for number in arguments.chunks:
            ply, parts, file = (folder / f"{number}{end}" for end in (".ply", "_parts.splatree", ".splatree"))
            counts.append(st.convert(chunks[:number], ply).num_written)
            st.build_folder(ply, parts)
            ply.unlink()
            st.convert(parts, file)
            scenes.append((parts, file))
        for kind, pair in zip(("folder", "file"), zip(*scenes, strict=True), strict=True):
            verbs = VERBS if kind == "folder" else ("info", "check", "render, near view", "render, near view, 100M")
            for verb in (verb for verb in verbs if arguments.only is None or arguments.only in verb):
                less, more = (run(*words_of(verb, scene, folder)) for scene in pair)
                rows.append(
                    {
                        "verb": verb,
                        "of a": kind,
                        "Gaussians": counts[1],
                        "peak MB": more.peak_bytes / 1e6,
                        "bytes for each Gaussian more": (more.peak_bytes - less.peak_bytes) / (counts[1] - counts[0]),
                        "CPU s": more.cpu_s,
                    }
                )
                print(rows[-1], flush=True)
        for kind, whole in (("folder", arguments.store), ("file", arguments.file)):
            if whole is not None:
                runs = [run(*words_of("render, near view", whole, folder)) for _ in range(PROCESS)]
                best = min(runs, key=lambda usage: usage.cpu_s)
                row = {"verb": "render, near view", "of a": kind, "Gaussians": 4_972_767}
                row |= {"peak MB": best.peak_bytes / 1e6, "bytes for each Gaussian more": "", "CPU s": best.cpu_s}
                rows.append(row)
    print(table(rows))
    save(
        "_".join(["stores", *re.findall(r"\w+", arguments.only or "")]),
        rows,
        about="What each verb takes of a scene on disk, on chunks of the real city",
    )


if __name__ == "__main__":
    main()
