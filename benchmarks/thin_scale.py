"""What thinning through files costs beside thinning in memory, and that both write the same file.

``python benchmarks/thin_scale.py [--chunks 10] [--degree 3] [--memory 500M 1G] [--folder /tmp]`` needs the shared city. Each
thinning is a command of its own; memory is measured as in `scale.py`.
"""

import argparse
import filecmp
import tempfile
from pathlib import Path

import splatree as st
from harness import DATA, save, table
from scale import figures, run

AMOUNTS = {"radius auto": ("--radius", "auto"), "keep 25 %": ("--keep", "0.25", "--method", "radius")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=10, help="chunks of the city, at most 10")
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--memory", nargs="+", default=["500M", "1G"])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    city = DATA / "trained" / "semarang_city"
    chunks = sorted(path for path in city.iterdir() if path.is_dir())[: arguments.chunks]
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        ply, whole, parts = (folder / f"{name}.ply" for name in ("city", "whole", "parts"))
        options = st.ConvertOptions(edit=st.EditOptions(sh_degree=arguments.degree))
        num_rows = st.convert(chunks, ply, options).num_written
        about = {"Gaussians": num_rows, "degree": arguments.degree}
        for amount, words in AMOUNTS.items():
            in_memory = run("thin", ply, whole, *words, "-q", "--force")
            rows.append(
                {**about, "to": amount, "thinning": "in memory", **figures(in_memory, in_memory, num_rows / 1e6)}
            )
            for memory in arguments.memory:
                usage = run("thin", ply, parts, *words, "--max-memory", memory, "-q", "--force")
                same = "yes" if filecmp.cmp(whole, parts, shallow=False) else "no"
                rows.append(
                    {
                        **about,
                        "to": amount,
                        "thinning": memory,
                        **figures(usage, in_memory, num_rows / 1e6),
                        "same file": same,
                    }
                )
                print(table(rows), flush=True)
    save("thin_scale", rows, about="Thinning the real city through files, beside thinning in memory")


if __name__ == "__main__":
    main()
