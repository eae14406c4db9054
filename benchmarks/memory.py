"""What each verb takes in memory: at most, and for each Gaussian more.

``python benchmarks/memory.py [--chunks 1 3] [--degree 3] [--only convert] [--folder /tmp]`` needs the shared city.
Each verb runs on fewer and on more chunks of the city, as a command of its own. Memory is measured as in `scale.py`. Where it
does not grow with the scene, rows go through in chunks or cells. Inputs with levels by a radius, a `.hier`, a compact
`.splatree` and a streamed SOG, are made first; a Gaussian is then one of the scene, without merged nodes (``--only of``).
"""

import argparse
import tempfile
from pathlib import Path

import splatree as st
from harness import DATA, save, table
from scale import run

VERBS = {
    **{
        f"convert to {suffix}": ("convert", f"out{suffix}")
        for suffix in (".ply", ".spz", ".splat", ".ksplat", ".glb", ".sog", ".compressed.ply")
    },
    "convert to .rad": ("convert", "out.rad"),
    "convert to .splatree": ("convert", "out.splatree"),
    **{
        f"convert to {suffix} --max-memory 300M": ("convert", f"out{suffix}", "--max-memory", "300M")
        for suffix in (".compressed.ply", ".ksplat", ".sog")
    },
    "convert --order morton --max-memory 300M": ("convert", "out.ply", "--order", "morton", "--max-memory", "300M"),
    "clean": ("clean", "out.ply", "--floaters"),
    "thin --radius": ("thin", "out.ply", "--radius", "auto"),
    "thin --radius --max-memory 500M": ("thin", "out.ply", "--radius", "auto", "--max-memory", "500M"),
    "thin --keep, by pairs": ("thin", "out.ply", "--keep", "0.25"),
    "build": ("build", "out.splatree"),
    "build --max-memory 500M": ("build", "parts.splatree", "--max-memory", "500M"),
    "build --method pairs": ("build", "out.splatree", "--method", "pairs"),
    "clusters alone": ("build", "out.splatree", "--flat", "--clusters", "auto"),
    **{
        f"clusters alone --max-memory {room}": (
            *("build", "out.splatree", "--flat", "--clusters", "auto", "--max-memory", room),
        )
        for room in ("300M", "500M")
    },
}

WITH_LEVELS = {
    "of .hier": ("convert", "levels.hier"),
    "of compact .splatree": ("convert", "compact.splatree", "--compact"),
    "of streamed SOG": ("stream", "web"),
}
"""Verb and output of what makes each input with levels."""

VERBS |= {
    f"{source}, {what}": words
    for source in WITH_LEVELS
    for what, words in (
        ("convert to .ply", ("convert", "out.ply")),
        ("convert to .splatree", ("convert", "out.splatree")),
        ("check", ("check",)),
        ("clean", ("clean", "out.ply", "--floaters")),
        ("build --max-memory 500M", ("build", "parts.splatree", "--method", "radius", "--max-memory", "500M")),
    )
    if source != "of compact .splatree" or what not in ("convert to .splatree", "check")  # which decode all of it
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, nargs=2, default=[1, 3], help="chunks of the city, fewer and more")
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--only", default="", help="only verbs whose line begins so, kept in a file of their own")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        scenes = [folder / "less.ply", folder / "more.ply"]
        options = st.ConvertOptions(edit=st.EditOptions(sh_degree=arguments.degree))
        counts = [
            st.convert(chunks[:number], scene, options).num_written
            for number, scene in zip(arguments.chunks, scenes, strict=True)
        ]
        rows = []
        chosen = {what: words for what, words in VERBS.items() if what.startswith(arguments.only)}
        for what, (verb, *words) in chosen.items():
            inputs = [with_levels(scene, what.partition(",")[0], folder) for scene in scenes]
            writes = [folder / words[0], *words[1:], "--force"] if words else []
            less, more = (run(verb, source, *writes, "-q") for source in inputs)
            slope = (more.peak_bytes - less.peak_bytes) / (counts[1] - counts[0])
            rows.append(
                {
                    "verb": what,
                    "degree": arguments.degree,
                    "Gaussians": counts[1],
                    "peak MB": more.peak_bytes / 1e6,
                    "bytes for each Gaussian more": slope,
                    "CPU s a million": 1e6 * more.cpu_s / counts[1],
                }
            )
            print(rows[-1], flush=True)
    print(table(rows))
    name = f"memory_{arguments.only}" if arguments.only else "memory"
    save(name, rows, about="Memory of each verb on chunks of the real city")


def with_levels(scene: Path, source: str, folder: Path) -> Path:
    """The input of a verb: the scene, or a form of it with levels, which is made when it is first asked for."""
    if source not in WITH_LEVELS:
        return scene
    (verb, name, *words), tree = WITH_LEVELS[source], folder / f"{scene.stem}.splatree"
    made = folder / f"{scene.stem}_{name}"
    if not tree.exists():
        run("build", scene, tree, "--method", "radius", "-q")
    if not made.exists():
        run(verb, tree, made, *words, "-q")
    return made


if __name__ == "__main__":
    main()
