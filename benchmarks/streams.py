"""Streams: the quality of the picture against the bytes that viewers load, and what writing them takes.

``python benchmarks/streams.py [--chunks 5_1 5_9] [--peer "npx splat-transform"]`` needs the shared city; ``--city`` adds all of
it, without the peer. Scenes have no harmonics, which the peer's processor path cannot write. The peer, splat-transform, makes
each level by halving the one before and writes them as its streamed SOG. Both streams are read and drawn as PlayCanvas does
(`splatree.stream.readers`) at 960 × 540, and compared with the library's picture of all Gaussians: PSNR, dB, with MB of whole
files; also with the dilation that scenes are trained with ("at 0.3"), which the page of `serve` sets. The exact cut is that of
the tree for as many nodes as our stream draws.

``--drawing`` makes another table alone: what the dilation of PlayCanvas and the blur of Spark cost in small and large windows.

``--ratios 2 2.3 2.5 2.83`` compares ladders instead: nodes of a level for each of the next coarser one, of both pieces and the
playbot by pairs, and of the playbot by a radius.

What Spark draws of a `.rad` is compared likewise, with the nodes as the tree stores them and as `stream` writes them. The last
table counts the chunks of 65,536 nodes that Spark loads in three orders; ``--loads`` makes this one alone.
"""

import argparse
import resource
import shlex
import subprocess
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

import splatree
from harness import DATA, Cost, measure, save, table
from splatree.constants import DILATION_PX2
from splatree.io.formats.rad.nodes import Nodes, log_sizes, nodes_of
from splatree.kernels.reference.paging import PAGE_ROWS, page_order
from splatree.maths.forests import links_from_preorder
from splatree.stream.rad import as_written
from splatree.stream.readers.playcanvas import select_playcanvas
from splatree.stream.readers.playcanvas_drawing import ENGINE_DILATION_PX2, draw_playcanvas
from splatree.stream.readers.sog_stream import SogStream, open_sog_stream
from splatree.stream.readers.spark import chunks_loaded, select_spark
from splatree.stream.report import views_of

CITY = DATA / "trained" / "semarang_city"
PLAYBOT = DATA / "trained" / "playbot"
LEVELS = 7
BUDGETS = (25_000, 50_000, 100_000, 200_000, 300_000, 1_000_000)
SPARKS_BUDGET = 2_500_000
"""Nodes that Spark draws on desktops unless a page says otherwise."""
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
    megabytes = float(stream.file_bytes[stream.files_of(levels)].sum()) / 1e6
    quality = {
        key: splatree.psnr(np.clip(draw_playcanvas(gaussians, camera, dilation_px2=dilation).image, 0, 1), truth)
        for key, dilation in (("dB", ENGINE_DILATION_PX2), ("dB at 0.3", DILATION_PX2))
    }
    return {"nodes": len(gaussians), "MB": megabytes} | quality


def in_windows(name: str, tree: splatree.Scene, budget: int = 100_000) -> list[dict[str, Any]]:
    """PSNR of what both viewers choose of our streams, drawn as the viewer comes, as it can be told to, and by the library."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        splatree.stream(tree, Path(folder) / "sog")
        stream, nodes = open_sog_stream(Path(folder) / "sog"), as_written(tree, splatree.StreamOptions())
        for width, (view, whole) in product((384, 1280), views_of(tree)):
            camera = whole.scaled(width / whole.width)
            truth = np.clip(splatree.render(tree, camera, select=EVERY_ROW).image, 0, 1)

            def quality(image: np.ndarray, truth: np.ndarray = truth) -> float:
                return splatree.psnr(np.clip(image, 0, 1), truth)

            chosen = {
                "all leaves": tree.gaussians.take(tree.tree.is_leaf),
                "sog": stream.gaussians_of(select_playcanvas(stream.ranges, camera, budget)),
                "rad": nodes.gaussians.take(select_spark(nodes, camera, budget).drawn),
            }
            for what, gaussians in chosen.items():
                row = {"scene": name, "window": f"{camera.width} × {camera.height}", "view": view, "what": what}
                if what != "rad":
                    row["PlayCanvas, dB"] = quality(draw_playcanvas(gaussians, camera).image)
                    told = draw_playcanvas(gaussians, camera, dilation_px2=DILATION_PX2)
                    row["PlayCanvas at 0.3, dB"] = quality(told.image)
                if what != "sog":
                    faint = splatree.Scene.flat(gaussians, mode="antialiased")
                    row["Spark, dB"] = quality(splatree.render(faint, camera, select=EVERY_ROW).image)
                usual = splatree.render(splatree.Scene.flat(gaussians), camera, select=EVERY_ROW)
                rows.append(row | {"library, dB": quality(usual.image)})
    return rows


def spark_chunks(name: str, tree: splatree.Scene, made: Sequence[splatree.Camera]) -> list[dict[str, Any]]:
    """Chunks of a .rad that a view needs: in the order that `stream` writes, in that of Spark's own tool, and breadth-first."""
    drawn = as_written(tree, splatree.StreamOptions())
    ours = nodes_of(drawn, Path("a.rad"))
    orders = {"ours": ours, "Spark's order": of_spark(drawn, ours), "breadth-first": breadth_first(drawn)}
    views = [*views_of(tree), *((f"made {i}", camera) for i, camera in enumerate(made))]
    rows = []
    for view, camera in views:
        for budget in (100_000, 300_000, 1_000_000):
            if budget < tree.tree.num_leaves:
                chosen = select_spark(drawn, camera, budget)
                row: dict[str, Any] = {"scene": name, "view": view, "budget": budget, "of": -(-len(ours) // PAGE_ROWS)}
                rows.append(row | {what: len(chunks_loaded(nodes, chosen)) for what, nodes in orders.items()})
    return rows


def of_spark(tree: splatree.Scene, ours: Nodes) -> Nodes:
    """The nodes of a tree in the order of Spark's tool: batches are divided at the middle of their boxes and end early."""
    g, above = tree.gaussians, len(ours.joined_root)
    rows = page_order(g.means, log_sizes(g), tree.tree.subtree_end, above, divide=at_the_middle, fills=False)
    place = np.argsort(ours.rows)[rows] + above  # of each row among ours
    num_children = np.concatenate([ours.num_children[:above], ours.num_children[place]])
    number = np.empty(len(rows) + 1, np.int64)
    number[rows] = np.arange(above, above + len(rows))
    first = np.where(num_children[above:] > 0, number[rows + 1], 0)
    first = np.concatenate([ours.first_child[:above], first]).astype(np.uint32)
    return Nodes(rows, num_children, first, ours.joined_root, None)


def at_the_middle(means: np.ndarray, rows: list[int]) -> list[list[int]]:
    """Spark's parts of a batch: two along the longest side of its box if that is three times the shortest, else octants."""
    if not rows:
        return []
    members = np.array(rows)
    centers = means[members]
    low, high = centers.min(axis=0), centers.max(axis=0)
    is_high, sides = centers >= (low + high) * np.float32(0.5), high - low
    if float(sides.max()) >= 3 * float(sides.min()):
        is_high = is_high[:, int(sides.argmax())]
        parts = sorted((members[is_high == side].tolist() for side in (False, True)), key=lambda part: -len(part))
    else:
        octants = is_high @ np.array([1, 2, 4])
        parts = [members[octants == octant].tolist() for octant in (0, 1, 3, 2, 6, 7, 5, 4)]
    return [part for part in parts if part]


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
        for budget in (100_000, 300_000, SPARKS_BUDGET):
            row: dict[str, Any] = {"scene": name, "view": view, "budget": budget}
            for what, options in scenes.items():
                scene = as_written(tree, options)
                drawn = scene.gaussians.take(select_spark(scene, camera, budget).drawn)
                image = splatree.render(splatree.Scene.flat(drawn, mode=scene.mode), camera, select=EVERY_ROW).image
                row[f"{what}, dB"] = splatree.psnr(np.clip(image, 0, 1), truth)
            rows.append(row)
    return rows


def in_playcanvas(
    name: str, scene: splatree.Scene, build: Cost, command: str | None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """What PlayCanvas draws and loads of our stream and the peer's, and what writing them takes."""
    tree = build.value
    with tempfile.TemporaryDirectory() as folder:
        write = measure(lambda: splatree.stream(tree, Path(folder) / "ours"))
        streams = {"ours": open_sog_stream(Path(folder) / "ours")}
        millions = len(scene) / 1e6
        costs = [
            cost_row(name, "splatree, levels", build, millions),
            cost_row(name, "splatree, stream", write, millions),
        ]
        costs[1] |= {"MB": write.value.bytes / 1e6, "levels": len(write.value.levels)}
        costs[1] |= {"MB a million": write.value.bytes / 1e6 / millions}
        if command:
            peer, cost = peers_stream(shlex.split(command), scene, Path(folder))
            streams["peer"] = open_sog_stream(peer)
            size = sum(path.stat().st_size for path in peer.rglob("*") if path.is_file()) / 1e6
            row = cost_row(name, "splat-transform, levels and stream", cost, millions)
            costs.append(row | {"MB": size, "levels": LEVELS, "MB a million": size / millions})
        print(table(costs))
        rows: list[dict[str, Any]] = []
        for view, camera in views_of(tree):
            truth = np.clip(splatree.render(tree, camera, select=EVERY_ROW).image, 0, 1)
            for budget in BUDGETS:
                if not len(scene) / 25 < budget < len(scene):
                    continue
                row: dict[str, Any] = {"scene": name, "view": view, "budget": budget}
                for what, stream in streams.items():
                    row |= {f"{what}, {key}": value for key, value in seen(stream, camera, budget, truth).items()}
                select = splatree.SelectOptions(pixel_error=0, budget=row["ours, nodes"])
                exact = splatree.render(tree, camera, select=select).image
                rows.append(row | {"exact cut, dB": splatree.psnr(np.clip(exact, 0, 1), truth)})
        print(table(rows))
    return rows, costs


def main() -> None:
    """Write, read, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", nargs="+", default=["5_1", "5_9"])
    parser.add_argument("--peer", help="the command of splat-transform; without it our stream stands alone")
    parser.add_argument("--spark", action="store_true", help="only what Spark draws and loads")
    parser.add_argument("--loads", action="store_true", help="only the chunks of a .rad that Spark loads")
    parser.add_argument("--drawing", action="store_true", help="only how the viewers draw")
    parser.add_argument("--city", action="store_true", help="the whole city too")
    parser.add_argument("--ratios", nargs="+", type=float, help="only compare ladders of these ratios")
    arguments = parser.parse_args()
    if arguments.ratios:
        compare_ladders(arguments.ratios, arguments.chunks)
        return
    if arguments.drawing:
        compare_drawing(arguments.chunks)
        return
    seen_rows, costs, quality, chunks = [], [], [], []
    made = list(splatree.read_cameras(DATA / "cameras" / "semarang_city_made_views.json"))[::4]
    scenes: list[tuple[str, list[Path], str | None]] = [
        (name, [CITY / name], arguments.peer) for name in arguments.chunks
    ]
    if arguments.city:
        scenes.append(("city", sorted(CITY.glob("5_*")), None))
    for name, files, peer in scenes:
        scene = splatree.edit(splatree.read(files), splatree.EditOptions(sh_degree=0))
        build = measure(lambda scene=scene: splatree.build_lod(scene, splatree.BuildOptions(method="pairs")))
        chunks += spark_chunks(name, build.value, made if name == "city" else ())
        print(table(chunks))
        if arguments.loads:
            continue
        if not arguments.spark:
            rows, cost = in_playcanvas(name, scene, build, peer)
            seen_rows, costs = seen_rows + rows, costs + cost
        quality += spark_quality(name, build.value)
        print(table(quality))
    about = (
        "Chunks of 65,536 nodes of a .rad that Spark loads within a budget: in the order that `stream` writes, in that of "
        "Spark's own tool, and breadth-first. Made views are every fourth of the shared ones of the city: a flight, round a "
        "stadium, from afar."
    )
    save("streams_rad", chunks, about=about)
    if arguments.loads:
        return
    quality += spark_quality(
        "playbot", splatree.build_lod(splatree.read(PLAYBOT), splatree.BuildOptions(method="pairs"))
    )
    print(table(quality))
    if not arguments.spark:
        about = (
            "PSNR of what PlayCanvas draws of a streamed SOG within a budget, with the MB of the files that it loads. Chunks of "
            "the city (5_1: 524,320 Gaussians, 5_9: 252,828) and all of it (4,972,767), degree 0. Levels by pairs; the peer is "
            "splat-transform on the processor."
        )
        save("streams", seen_rows, about=about)
        about = "What making the levels and writing the stream takes, and the bytes of all levels."
        save("streams_cost", costs, about=about)
    about = "PSNR of what Spark draws of a .rad within a budget, with nodes as the tree stores them and as `stream` writes them."
    save("streams_spark", quality, about=about)


def compare_drawing(chunks: list[str]) -> None:
    """What viewers lose by how they draw, of both pieces of the city and the playbot."""
    rows: list[dict[str, Any]] = []
    for name, path in [*((name, CITY / name) for name in chunks), ("playbot", PLAYBOT)]:
        scene = splatree.edit(splatree.read(path), splatree.EditOptions(sh_degree=0))
        rows += in_windows(name, splatree.build_lod(scene, splatree.BuildOptions(method="pairs")))
    print(table(rows))
    about = (
        "PSNR against the library's picture of all leaves, of all leaves and of what PlayCanvas (sog) and Spark (rad) choose "
        "within 100,000 nodes: as the viewers draw unless they are told otherwise, PlayCanvas with the usual dilation of "
        "0.3 px², and by the library, which is what Spark draws with `preBlurAmount: 0.3, blurAmount: 0`."
    )
    save("streams_drawing", rows, about=about)


def compare_ladders(ratios: list[float], chunks: list[str]) -> None:
    """What PlayCanvas draws, with the usual dilation, of streams whose levels differ in size by each ratio."""
    rows: list[dict[str, Any]] = []
    scenes = [(name, CITY / name, "pairs") for name in chunks] + [("playbot", PLAYBOT, m) for m in ("pairs", "radius")]
    for name, path, method in scenes:
        scene = splatree.edit(splatree.read(path), splatree.EditOptions(sh_degree=0))
        tree = splatree.build_lod(scene, splatree.BuildOptions(method))
        with tempfile.TemporaryDirectory() as folder:
            streams = {}
            for ratio in ratios:
                written = splatree.stream(tree, Path(folder) / str(ratio), options=splatree.StreamOptions(ratio=ratio))
                streams[ratio] = open_sog_stream(Path(folder) / str(ratio)), written.bytes / 1e6
            for view, camera in views_of(tree):
                truth = np.clip(splatree.render(tree, camera, select=EVERY_ROW).image, 0, 1)
                for budget in (n for n in BUDGETS if len(scene) / 25 < n < len(scene)):
                    row: dict[str, Any] = {"scene": name, "levels": method, "view": view, "budget": budget}
                    for ratio, (stream, megabytes) in streams.items():
                        row[f"{ratio:g}, dB"] = seen(stream, camera, budget, truth)["dB at 0.3"]
                        row[f"{ratio:g}, MB of all levels"] = megabytes
                    rows.append(row)
    print(table(rows))
    for name, method in dict.fromkeys((row["scene"], row["levels"]) for row in rows):
        for view in ("near", "middle", "far"):
            some = [row for row in rows if (row["scene"], row["levels"], row["view"]) == (name, method, view)]
            means = {
                f"{ratio:g}": round(float(np.mean([row[f"{ratio:g}, dB"] for row in some])), 2) for ratio in ratios
            }
            print(name, method, view, means)
    save(
        "streams_ratios",
        rows,
        about="What PlayCanvas draws of a streamed SOG within a budget, by the ratio of its levels.",
    )


def cost_row(scene: str, what: str, cost: Cost, millions: float) -> dict[str, Any]:
    """One line of the costs."""
    return {
        "scene": scene,
        "what": what,
        "cpu_s": cost.cpu_s,
        "cpu_s a million": cost.cpu_s / millions,
        "peak MB": cost.peak_bytes / 1e6,
    }


if __name__ == "__main__":
    main()
