"""Streams: the quality of the picture against the bytes that viewers load, and what writing them takes.

``python benchmarks/streams.py [--chunk 5_1] [--peer "npx splat-transform"]`` needs the shared city; ``--city`` adds the chunks of
a `.rad` of all of it. The scene is one chunk of the city without harmonics, which the peer's processor path cannot write.
The peer, splat-transform, makes each level by halving the one before and writes them as its streamed SOG. Both streams are read
as PlayCanvas reads them (`splatree.stream.readers.playcanvas`), drawn by the library at 960 × 540, and compared with that of
all Gaussians: PSNR, dB, with MB of whole files. The exact cut is that of the tree for as many nodes as our stream draws.

What Spark draws of a `.rad` is compared likewise, with the nodes as the tree stores them and as `stream` writes them. The last
table counts the chunks of 65,536 nodes that Spark loads, of what `stream` writes and of the tree in two orders.
"""

import argparse
import resource
import shlex
import subprocess
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import splatree
from harness import DATA, Cost, measure, save, table
from splatree.io.formats.rad.nodes import Nodes, nodes_of
from splatree.maths.forests import links_from_preorder
from splatree.stream.rad import as_written
from splatree.stream.readers.playcanvas import select_playcanvas
from splatree.stream.readers.sog_stream import SogStream, open_sog_stream
from splatree.stream.readers.spark import chunks_loaded, select_spark
from splatree.stream.report import views_of

CITY = DATA / "trained" / "semarang_city"
PLAYBOT = DATA / "trained" / "playbot"
LEVELS = 7
EVERY_ROW = splatree.SelectOptions(pixel_error=0)


def peers_stream(peer: list[str], scene: splatree.Scene, folder: Path) -> tuple[Path, Cost]:
    """The peer's stream of the same Gaussians, and what its levels and files took."""
    files = [folder / f"{level}.ply" for level in range(LEVELS)]
    splatree.write(scene, files[0])
    output = folder / "peer" / "lod-meta.json"
    output.parent.mkdir()

    def work() -> None:
        for fine, coarse in pairwise(files):
            run([*peer, "-w", "-g", "cpu", "-q", fine, "--decimate", "50%", coarse])
        tagged = [word for level, file in enumerate(files) for word in (file, "-l", str(level))]
        run([*peer, "-w", "-g", "cpu", "-q", *tagged, output])

    return output.parent, measure_children(work)


def run(words: list[Any]) -> None:
    """Run a command."""
    subprocess.run([str(word) for word in words], check=True, capture_output=True)


def measure_children(work: Any) -> Cost:
    """Cost of the commands that a function runs."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    work()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(cpu, time.perf_counter() - start, after.ru_maxrss * 1024)


def seen(stream: SogStream, camera: splatree.Camera, budget: int, truth: np.ndarray) -> dict[str, Any]:
    """What PlayCanvas draws and loads of a stream in a view."""
    levels = select_playcanvas(stream.ranges, camera, budget)
    gaussians = stream.gaussians_of(levels)
    image = splatree.render(splatree.Scene.flat(gaussians, mode=stream.mode), camera, select=EVERY_ROW).image
    megabytes = float(stream.file_bytes[stream.files_of(levels)].sum()) / 1e6
    return {"nodes": len(gaussians), "MB": megabytes, "dB": splatree.psnr(np.clip(image, 0, 1), truth)}


def spark_chunks(name: str, tree: splatree.Scene) -> list[dict[str, Any]]:
    """Chunks of a .rad that a view needs: of the nodes that `stream` writes, and of those that the tree stores."""
    drawn = as_written(tree, splatree.StreamOptions())
    stored = replace(tree, tree=replace(tree.tree, curves=None), clusters=None, blocks=None)
    orders = {"ours": (drawn, nodes_of(drawn, Path("a.rad")))}
    orders["as stored"] = (stored, nodes_of(stored, Path("a.rad")))
    orders["as stored, breadth-first"] = (stored, breadth_first(stored))
    rows = []
    for view, camera in views_of(tree):
        for budget in (100_000, 300_000, 1_000_000):
            if budget < tree.tree.num_leaves:
                row: dict[str, Any] = {"scene": name, "view": view, "budget": budget}
                for what, (scene, nodes) in orders.items():
                    loaded = chunks_loaded(nodes, select_spark(scene, camera, budget))
                    row |= {what: len(loaded), f"{what}, of": -(-len(nodes) // 65536)}
                rows.append(row)
    return rows


def breadth_first(tree: splatree.Scene) -> Nodes:
    """The nodes of a tree in breadth-first order."""
    nodes = nodes_of(tree, Path("a.rad"))
    links = links_from_preorder(tree.tree.depth)
    above = len(nodes.joined_root)
    first = np.where(links.num_children > 0, links.first_child + above, 0).astype(np.uint32)
    counts, num_roots = links.num_children, int((tree.tree.depth == 0).sum())
    if above:
        counts, first = np.append(np.int32(num_roots), counts), np.append(np.uint32(1), first)
    return Nodes(links.row_from_node, counts, first, nodes.joined_root, None)


def spark_quality(name: str, tree: splatree.Scene) -> list[dict[str, Any]]:
    """What Spark draws of a .rad whose nodes are as the tree stores them, and as `stream` writes them."""
    scenes = {"stored": splatree.StreamOptions(node_px=0.0), "as drawn": splatree.StreamOptions()}
    rows = []
    for view, camera in views_of(tree):
        truth = np.clip(splatree.render(tree, camera, select=EVERY_ROW).image, 0, 1)
        for budget in (100_000, 300_000):
            row: dict[str, Any] = {"scene": name, "view": view, "budget": budget}
            for what, options in scenes.items():
                scene = as_written(tree, options)
                drawn = scene.gaussians.take(select_spark(scene, camera, budget).drawn)
                image = splatree.render(splatree.Scene.flat(drawn, mode=scene.mode), camera, select=EVERY_ROW).image
                row[f"{what}, dB"] = splatree.psnr(np.clip(image, 0, 1), truth)
            rows.append(row)
    return rows


def in_playcanvas(scene: splatree.Scene, build: Cost, command: str | None) -> None:
    """What PlayCanvas draws and loads of our stream and the peer's, and what writing them takes."""
    tree = build.value
    with tempfile.TemporaryDirectory() as folder:
        write = measure(lambda: splatree.stream(tree, Path(folder) / "ours"))
        streams = {"ours": open_sog_stream(Path(folder) / "ours")}
        millions = len(scene) / 1e6
        costs = [cost_row("splatree, levels", build, millions), cost_row("splatree, stream", write, millions)]
        costs[1] |= {"MB": write.value.bytes / 1e6, "levels": len(write.value.levels)}
        if command:
            peer, cost = peers_stream(shlex.split(command), scene, Path(folder))
            streams["peer"] = open_sog_stream(peer)
            size = sum(path.stat().st_size for path in peer.rglob("*") if path.is_file())
            costs.append(
                cost_row("splat-transform, levels and stream", cost, millions) | {"MB": size / 1e6, "levels": LEVELS}
            )
        print(table(costs))
        rows: list[dict[str, Any]] = []
        for view, camera in views_of(tree):
            truth = np.clip(splatree.render(tree, camera, select=EVERY_ROW).image, 0, 1)
            for budget in (50_000, 100_000, 200_000):
                row: dict[str, Any] = {"view": view, "budget": budget}
                for name, stream in streams.items():
                    row |= {f"{name}, {key}": value for key, value in seen(stream, camera, budget, truth).items()}
                select = splatree.SelectOptions(pixel_error=0, budget=row["ours, nodes"])
                exact = splatree.render(tree, camera, select=select).image
                rows.append(row | {"exact cut, dB": splatree.psnr(np.clip(exact, 0, 1), truth)})
        print(table(rows))
    about = (
        f"One chunk of the city ({len(scene):,} Gaussians, degree 0): PSNR of what PlayCanvas draws of a streamed SOG within a "
        "budget, with the MB of the files that it loads. Levels by pairs; the peer is splat-transform on the processor."
    )
    save("streams", rows, about=about)
    save(
        "streams_cost", costs, about="What making the levels and writing the stream takes, and the bytes of all levels."
    )


def main() -> None:
    """Write, read, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunk", default="5_1")
    parser.add_argument("--peer", help="the command of splat-transform; without it our stream stands alone")
    parser.add_argument("--spark", action="store_true", help="only what Spark draws and loads")
    parser.add_argument("--city", action="store_true", help="count Spark's chunks of the whole city too")
    arguments = parser.parse_args()
    scene = splatree.edit(splatree.read(CITY / arguments.chunk), splatree.EditOptions(sh_degree=0))
    build = measure(lambda: splatree.build_lod(scene, splatree.BuildOptions(method="pairs")))
    tree = build.value
    if not arguments.spark:
        in_playcanvas(scene, build, arguments.peer)
    playbot = splatree.build_lod(splatree.read(PLAYBOT), splatree.BuildOptions(method="pairs"))
    quality = spark_quality(arguments.chunk, tree) + spark_quality("playbot", playbot)
    print(table(quality))
    chunks = spark_chunks(arguments.chunk, tree)
    if arguments.city:
        city = splatree.edit(splatree.read(sorted(CITY.glob("5_*"))), splatree.EditOptions(sh_degree=0))
        chunks += spark_chunks("city", splatree.build_lod(city, splatree.BuildOptions(method="pairs")))
    print(table(chunks))
    about = "PSNR of what Spark draws of a .rad within a budget, with nodes as the tree stores them and as `stream` writes them."
    save("streams_spark", quality, about=about)
    about = (
        "Chunks of 65,536 nodes of a .rad that Spark loads within a budget: of what `stream` writes, and of the nodes that the "
        "tree stores in the same order and breadth-first."
    )
    save("streams_rad", chunks, about=about)


def cost_row(what: str, cost: Cost, millions: float) -> dict[str, Any]:
    """One line of the costs."""
    return {
        "what": what,
        "cpu_s": cost.cpu_s,
        "cpu_s a million": cost.cpu_s / millions,
        "peak MB": cost.peak_bytes / 1e6,
    }


if __name__ == "__main__":
    main()
