"""What the index of pages costs when one ``.splatree`` is written, and saves when it is opened to be drawn page by page.

``python benchmarks/opening.py --scene city.splatree [--folder /tmp]`` writes the scene with and without an index, and opens both
in turn. *Write* and *open* are processor seconds, *open* the median of ``--runs``.
"""

import argparse
import statistics
import tempfile
from functools import partial
from pathlib import Path

import splatree as st
from harness import measure, save, table
from splatree.io.tree_runs import stored_runs


def write(scene: Path, target: Path, has_index: bool) -> None:
    """Write the scene in runs of rows."""
    tree = stored_runs(scene)
    assert tree is not None
    with st.create_scene(target, tree.head, pages=has_index) as writer:
        for run in tree.runs("write"):
            writer.append(run)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, required=True, help="a large .splatree with levels")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        paths = {has_index: Path(name) / f"{has_index}.splatree" for has_index in (False, True)}
        rows: dict[bool, dict[str, object]] = {}
        for has_index, path in paths.items():
            cost = measure(partial(write, arguments.scene, path, has_index))
            size = path.stat().st_size / 1e6
            rows[has_index] = {"index": "yes" if has_index else "no", "MB": size, "write CPU s": cost.cpu_s}
        opened: dict[bool, list[float]] = {False: [], True: []}
        for _ in range(arguments.runs):
            for has_index, path in paths.items():
                store = measure(partial(st.open_store, path))
                num_rows = len(store.value)
                store.value.close()
                opened[has_index].append(store.cpu_s)
        found = [{"rows": num_rows, **row, "open CPU s": statistics.median(opened[has])} for has, row in rows.items()]
    print(table(found))
    save(
        "opening",
        found,
        about="Writing and opening one .splatree of a whole city, with and without an index of its pages",
    )


if __name__ == "__main__":
    main()
