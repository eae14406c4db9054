"""The GPU back end on the machine at hand: parity first, then selections, frames by stage, other renderers, memory. One command.

    scripts/build && python benchmarks/gpu.py            # at most 8 minutes; writes benchmarks/results/gpu.json

The machine needs an NVIDIA GPU with its driver, Python with NumPy and Pillow, NVRTC (torch brings it, or nvidia-cuda-nvrtc), and
to build the core a C++ compiler, cmake, ninja and nanobind; pytest and hypothesis for the parity tests. No network: `scripts/gpu`
gathers wheels where there is one, and installs, builds and measures where there is none. With torch, and gsplat or
gaussian-splatting, these draw the same Gaussians too (gpu_peers.py); else rows say why they are absent.

- parity: the device's tests of this repository, on this GPU; nothing is measured if one fails.
- selection: t_f of ours, of FilterGS's scheme (all nodes, a table of ancestors) and of the traversal level by level, same
  rows; on synthetic trees (a relief, four children a node, seven levels, a tenth as thick as wide), from near, mid and far at
  1080p. Times hold everything from the upload of the view's numbers to the last kernel; the median of several runs.
- frames: the bundled piece of a real city and a synthetic tree, at 1080p and 4K: stages one by one, and replayed frames.
- train: a step of training on the city's leaves, stage by stage with its copies, beside the processor's on all its threads.
- kmeans: a step on points of such a tree, beside the processor's.

Each part is a process of its own and has a share of the eight minutes (`SECONDS`). A part that has used it is ended; what it
measured until then is kept, and a row says what was cut off.

``--dry FOLDER`` runs all of it on tiny sizes on the emulator of the tests, which is compiled into the folder, and keeps
nothing: its times say nothing and are not printed.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import splatree as st
from gpu_peers import peer_rows
from harness import ROOT, save, table
from splatree.kernels.cpu.build.kmeans import assign
from splatree.kernels.cuda.baselines import Baselines
from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.device import open_device
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.kmeans import DevicePoints
from splatree.kernels.cuda.library import dotted
from splatree.kernels.cuda.renderer import Renderer
from splatree.lod.blocks import with_blocks
from splatree.maths.morton import morton_codes
from splatree.scene.tree import GaussianTree
from splatree.scene.view import view_of
from training_step import train_row

DEMO = ROOT / "src" / "splatree" / "data" / "semarang_5_9.sog"
FAN_OUT = 4
BYTES_OF_BLOCK, BYTES_OF_ROW, BYTES_OF_DRAWN = 40, 1, 28
"""What a selection has to read at least: bounds of a block, the class of a row visited; centre, scales, opacity of one drawn."""


SECONDS = {"parity": 150, "device": 15, "selection": 95, "frame": 130, "train": 35, "kmeans": 50}
"""What each part may take on the clock before it is ended: 475 s in all."""


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    nodes: tuple[int, ...] = (1_000_000, 10_000_000, 50_000_000)
    """Nodes of the synthetic trees."""
    levels: int = 7
    """Their levels."""
    sizes: tuple[tuple[int, int], ...] = ((1920, 1080), (3840, 2160))
    """Pictures."""
    repeat: int = 9
    """Runs of which the median is taken."""
    frames: int = 50
    """Replayed frames."""
    leaves: int | None = None
    """Gaussians of the real scene; None: all."""
    rows: int = 1 << 20
    """Rows that renderers have room for at first."""
    kmeans: tuple[tuple[int, int], ...] = ((1_000_000, 8192), (6_000_000, 32768))
    """Points and clusters of K-means."""
    photo: tuple[int, int] = (800, 600)
    """Size of the picture that is trained on."""


DRY = Plan(
    nodes=(200,),
    levels=4,
    sizes=((64, 48),),
    repeat=1,
    frames=2,
    leaves=100,
    rows=128,
    kmeans=((200, 40),),
    photo=(48, 32),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry", type=Path, metavar="FOLDER", help="run everything tiny on the emulator, keep nothing")
    parser.add_argument(
        "--part", choices=[*SECONDS][1:], help="print the rows of one part as JSON: what this command runs"
    )
    arguments = parser.parse_args()
    if arguments.part:
        device, plan = (emulator(arguments.dry), DRY) if arguments.dry else (open_device(0), Plan())
        for row in PARTS[arguments.part](device, plan):
            print(json.dumps(row, default=float), flush=True)
        return
    if not arguments.dry:
        check_parity()
    rows: list[dict[str, Any]] = []
    for part in PARTS:
        warnings = [f"-W{option}" for option in sys.warnoptions]
        command = [sys.executable, *warnings, *sys.argv, "--part", part]
        rows += rows_of(part, command, None if arguments.dry else SECONDS[part])
    device_name = next((row["name"] for row in rows if "name" in row), "a device that did not say its name")
    rows = [row for row in rows if "name" not in row]
    if arguments.dry:
        print(f"dry run: {len(rows)} rows, {len({row['what'] for row in rows})} kinds")
        return
    print(table(rows))
    save("gpu", rows, about=f"The GPU back end on {device_name}; milliseconds on the device, medians.")


def rows_of(part: str, command: list[str], seconds: float | None) -> list[dict[str, Any]]:
    """The rows that the command of a part prints until its time is used, and then one that says so; None: until it ends."""
    cut_off: list[dict[str, Any]] = []
    try:
        printed = subprocess.run(command, stdout=subprocess.PIPE, check=False, timeout=seconds)
        if printed.returncode:
            sys.exit(f"gpu: the part {part!r} failed; nothing is kept")
        output = printed.stdout
    except subprocess.TimeoutExpired as late:
        output = late.stdout or b""
        cut_off = [{"what": part, "absent": f"what would have followed: the {seconds:g} s of this part were used"}]
    whole_lines = output[: output.rfind(b"\n") + 1].splitlines()
    return [json.loads(line) for line in whole_lines] + cut_off


def emulator(folder: Path) -> Device:
    """The emulator of the tests as a device."""
    sys.path.insert(0, str(ROOT / "tests" / "kernels"))
    from simt_device import Emulator, compile_emulator

    library = folder / "libsimt.so"
    return Emulator(library if library.exists() else compile_emulator(folder))


def describe(device: Device) -> str:
    """What was measured on."""
    version = device.driver.version()
    nvrtc = ".".join(map(str, load_compiler(version).version))
    memory = f"{device.memory_bytes / 2**30:.0f} GiB"
    return f"{device.name} ({device.architecture}, {memory}), driver for CUDA {dotted(version)}, NVRTC {nvrtc}"


def check_parity() -> None:
    """The device's tests on this GPU."""
    files = [
        "tests/kernels/test_cuda_stages.py",
        "tests/kernels/test_cuda_renderer.py",
        "tests/kernels/test_cuda_backward.py",
        "tests/kernels/test_cuda_kmeans.py",
        "tests/train/test_device.py",
        "tests/laws/test_select_cuda.py",
    ]
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-k",
        "gpu",
        "-p",
        "no:cacheprovider",
        *files,
        "tests/render/test_device.py",
    ]
    try:
        found = subprocess.run(words, cwd=ROOT, check=False, timeout=SECONDS["parity"])
    except subprocess.TimeoutExpired:
        sys.exit(f"gpu: the device's tests were not done after {SECONDS['parity']} s; nothing was measured")
    if found.returncode:
        sys.exit("gpu: the device's picture is not the processor's; nothing was measured")


def selection_rows(device: Device, plan: Plan) -> Iterator[dict[str, Any]]:
    """t_f of three selections that find the same rows."""
    bytes_per_second = bandwidth(device, 1 << (28 if plan.frames > 2 else 12), plan.repeat)
    for nodes in plan.nodes:
        scene = synthetic(nodes, plan.levels)
        assert scene.blocks is not None
        renderer = Renderer(device, scene.gaussians, scene.tree, scene.blocks, rows=plan.rows, pairs=1)
        others = Baselines(device, renderer.scene, scene.tree)
        for camera in views(plan.sizes[0]):
            yield selection_row(device, plan, scene, renderer, others, camera, bytes_per_second)


def selection_row(
    device: Device,
    plan: Plan,
    scene: st.Scene,
    renderer: Renderer,
    others: Baselines,
    camera: st.Camera,
    bytes_per_second: float,
) -> dict[str, Any]:
    """One tree and view."""
    view = (view_of(scene, camera), st.SelectOptions())
    rows, visited = renderer.select(*view)
    for find in (others.serial, others.paper):
        if not np.array_equal(np.sort(find(*view)), rows):
            sys.exit(f"gpu: the selections of {len(scene):,} nodes, view {camera.name}, differ; nothing is kept")

    def other(run: Callable[[], None]) -> float:
        def once() -> None:
            others.start(*view)
            run()

        return median_ms(device, plan, once)

    ours = median_ms(device, plan, lambda: renderer.enqueue_selection(*view))
    paper, serial = other(others.run_paper), other(others.run_serial)
    num_blocks = len(scene.blocks) if scene.blocks else 0
    least = BYTES_OF_BLOCK * num_blocks + BYTES_OF_ROW * visited + BYTES_OF_DRAWN * len(rows)
    return {
        "what": "selection",
        "scene": f"{len(scene):,} nodes",
        "view": camera.name,
        "drawn": len(rows),
        "visited": visited,
        "ours ms": ours,
        "paper ms": paper,
        "serial ms": serial,
        "paper / ours": paper / ours,
        "serial / ours": serial / ours,
        "ours / roofline": ours / (1e3 * least / bytes_per_second),
        "MB held": renderer.bytes_held / 1e6,
        "MB of ancestors": others.table_bytes["paper"] / 1e6,
    }


def frame_rows(device: Device, plan: Plan) -> Iterator[dict[str, Any]]:
    """Stages and replayed frames of a real scene, of its levels, and of a synthetic tree."""
    real = leaves_of(plan)
    leaves, cut = st.SelectOptions(pixel_error=0.0), st.SelectOptions()
    city = with_blocks(st.build_lod(real))
    relief = synthetic(min(10_000_000, max(plan.nodes)), plan.levels)
    for width, height in plan.sizes:
        orbit = st.orbit(city, st.PathOptions(views=1, width=width, height=height))[0]
        cases = {
            "city, leaves": (city, orbit, leaves),
            "city, levels": (city, orbit, cut),
            "relief, levels": (relief, views((width, height))[1], cut),
        }
        rows = {name: frame_row(device, plan, name, *case) for name, case in cases.items()}
        yield from rows.values()
        ours_ms = {name: rows[f"city, {name}"]["frame ms"] for name in ("leaves", "levels")}
        yield from peer_rows(real, orbit, ours_ms, repeat=plan.repeat, frames=plan.frames)


def frame_row(
    device: Device, plan: Plan, name: str, scene: st.Scene, camera: st.Camera, select: st.SelectOptions
) -> dict[str, Any]:
    """One scene and view."""
    assert scene.blocks is not None
    view = view_of(scene, camera)
    renderer = Renderer(
        device, scene.gaussians, scene.tree, scene.blocks, scene.ids, rows=plan.rows, pairs=4 * plan.rows
    )
    picture = renderer.draw(view, select)
    wanted = st.render(scene, camera, select=select).image
    traces = [renderer.trace(view, select) for _ in range(plan.repeat)]
    stages = {f"{s} ms": statistics.median(t.milliseconds[s] for t in traces) for s in traces[0].milliseconds}
    renderer.draw(view, select)  # recorded now, if it was not

    def frames() -> None:
        for _ in range(plan.frames):
            renderer.enqueue(view, select)

    frame = median_ms(device, plan, frames) / plan.frames
    return {
        "what": "frame",
        "scene": name,
        "view": f"{camera.width} × {camera.height}",
        "drawn": picture.counters["num_selected"],
        "N_P": picture.counters["num_pairs"],
        **stages,
        "frame ms": frame,
        "FPS": 1e3 / frame,
        "dB to the processor": st.psnr(picture.image.numpy(), wanted),
        "MB held": renderer.bytes_held / 1e6,
    }


def leaves_of(plan: Plan) -> st.Scene:
    """The piece of a real city, or as much of it as is planned."""
    real = st.read(DEMO)
    if plan.leaves is None:
        return real
    return st.Scene.flat(real.gaussians.take(np.arange(plan.leaves)), mode=real.mode)


def kmeans_rows(device: Device, plan: Plan) -> Iterator[dict[str, Any]]:
    """A step of K-means with its results on the host, beside the processor's on all its threads."""
    for num_points, num_clusters in plan.kmeans:
        points = synthetic(num_points, plan.levels).gaussians.means
        points = np.ascontiguousarray(points[np.argsort(morton_codes(points), kind="stable")])
        centers = points[:: max(1, len(points) // num_clusters)].copy()
        on_device = DevicePoints(device, points)
        found = on_device.assign(centers)
        took, wall, cpu = [], [], []
        for _ in range(plan.repeat):
            start = time.perf_counter()
            on_device.assign(centers)
            took.append(1e3 * (time.perf_counter() - start))
        for _ in range(3):
            start, busy = time.perf_counter(), time.process_time()
            wanted = assign(points, centers)
            wall.append(1e3 * (time.perf_counter() - start))
            cpu.append(1e3 * (time.process_time() - busy))
        ours = statistics.median(took)
        yield {
            "what": "kmeans",
            "scene": f"{len(points):,} points",
            "view": f"{len(centers):,} centres",
            "ours ms": ours,
            "processor wall ms": min(wall),
            "processor CPU ms": min(cpu),
            "processor wall / ours": min(wall) / ours,
            "other labels": float((found.labels != wanted.labels).mean()),
        }


def median_ms(device: Device, plan: Plan, work: Callable[[], object]) -> float:
    """Time of enqueued work between two points of the stream."""
    work()
    took = []
    for _ in range(plan.repeat):
        before, after = device.event(), device.event()
        before.record()
        work()
        after.record()
        after.wait()
        took.append(after.milliseconds_since(before))
    return max(statistics.median(took), 1e-6)


def bandwidth(device: Device, num_bytes: int, repeat: int) -> float:
    """Bytes a second that the device writes."""
    array = device.empty((num_bytes,), np.uint8)
    took = median_ms(device, Plan(repeat=repeat), array.clear)
    return 1e3 * num_bytes / took


def views(size: tuple[int, int]) -> list[st.Camera]:
    """From just above the relief, from where a part of it is seen, and from where all is."""
    width, height = size
    eyes = {"near": (0.5, 0.45, 0.02), "mid": (0.5, 0.2, 0.15), "far": (0.5, -0.6, 1.0)}
    target, up = np.array([0.5, 0.55, 0.0]), np.array([0, 0, 1.0])
    cameras = {
        name: st.Camera.look_at(np.array(eye), target, up=up, width=width, height=height) for name, eye in eyes.items()
    }
    return [replace(camera, near=1e-4, name=name) for name, camera in cameras.items()]


def synthetic(num_nodes: int, levels: int) -> st.Scene:
    """A relief over the unit square: roots on a grid, below each a complete tree in preorder; a node fills its cell."""
    x, y, depths = preorder(0.5, 0.5, 0, levels)
    per_root = len(x)
    num_roots = max(1, round(num_nodes / per_root))
    side = int(np.ceil(np.sqrt(num_roots)))
    n = num_roots * per_root
    rng = np.random.default_rng(0)
    root = np.repeat(np.arange(num_roots), per_root)
    level = np.tile(depths, num_roots)
    cell = (1.0 / side) * 0.5 ** level.astype(np.float32)
    means = np.empty((n, 3), np.float32)
    means[:, 0] = (root % side + np.tile(x, num_roots)) / side + 0.2 * cell * rng.standard_normal(n, np.float32)
    means[:, 1] = (root // side + np.tile(y, num_roots)) / side + 0.2 * cell * rng.standard_normal(n, np.float32)
    means[:, 2] = 0.02 * np.sin(25 * means[:, 0]) * np.cos(31 * means[:, 1]) + 0.1 * cell * rng.standard_normal(
        n, np.float32
    )
    log_scales = (
        np.log(0.5 * cell)[:, None] + np.float32([0, 0, np.log(0.1)]) + 0.4 * rng.standard_normal((n, 3), np.float32)
    )
    size = np.array([(FAN_OUT ** (levels - d) - 1) // (FAN_OUT - 1) for d in range(levels)])
    end = (np.arange(n) + size[level]).astype(np.int32)
    gaussians = st.Gaussians(
        means,
        rng.standard_normal((n, 4), np.float32) * np.float32([0, 0, 0, 1]) + np.float32([1, 0, 0, 0]),
        log_scales.astype(np.float32),
        1 + 1.5 * rng.standard_normal(n, np.float32),
        0.5 * rng.standard_normal((n, 1, 3), np.float32),
    )
    extents = (8 * cell).astype(np.float32)
    return with_blocks(st.Scene(gaussians, GaussianTree(end, level.astype(np.uint8), extents)))


def preorder(x: float, y: float, depth: int, levels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres and depths of a complete tree over a cell of side 2^-depth, in preorder."""
    own = (np.array([x], np.float32), np.array([y], np.float32), np.array([depth], np.int64))
    if depth + 1 == levels:
        return own
    step = 0.25 * 0.5**depth
    below = [preorder(x + sx * step, y + sy * step, depth + 1, levels) for sy in (-1, 1) for sx in (-1, 1)]
    return tuple(np.concatenate([own[i], *(b[i] for b in below)]) for i in range(3))  # type: ignore[return-value]


PARTS: dict[str, Callable[[Device, Plan], Iterator[dict[str, Any]]]] = {
    "device": lambda device, plan: iter([{"what": "device", "name": describe(device)}]),
    "selection": selection_rows,
    "frame": frame_rows,
    "train": lambda device, plan: iter([train_row(device, leaves_of(plan), plan.photo, plan.repeat)]),
    "kmeans": kmeans_rows,
}
"""What is measured, each in a process of its own."""


if __name__ == "__main__":
    main()
