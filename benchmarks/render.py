"""CPU time of each stage of a frame after the selection, beside plain scalar loops of the same maths, in one run, on one thread.

Workloads: the projection of 2 M Gaussians, of which about half touch the picture; lists and blending of 200 k Gaussians at
960 × 540 px with about 760 k pairs; and, if the shared data is there, a frame of the real city with all leaves in view.

``python benchmarks/render.py`` (needs a C++ compiler for the scalar loops)
"""

import ctypes
import json
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import splatree as st
from harness import DATA, measure, save, table
from splatree.kernels.cpu import _core
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.cpu.frame.view import pack_view

WIDTH, HEIGHT = 960, 540
REPEAT = 9
LEAVES = st.SelectOptions(pixel_error=0)
ALIGNED = 64


def main() -> None:
    scalar = compile_scalar()
    rows = project_rows(scalar) + frame_rows(scalar) + city_rows()
    print(table(rows))
    save(
        "render",
        rows,
        about="CPU-milliseconds of each stage of a frame on one thread, cheapest of nine, and of plain scalar loops.",
    )


def project_rows(scalar: ctypes.CDLL) -> list[dict[str, Any]]:
    """The projection of 2 M Gaussians, memory touched beforehand."""
    g = cloud(2_000_000, reach=1.4, scale=0.02, seed=0)
    camera = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=WIDTH, height=HEIGHT)
    rows = np.arange(len(g), dtype=np.int32)
    view = st.View(camera, sh_degree=0)
    packed, threshold = pack_view(view), view.threshold
    numbers = np.concatenate([np.ravel(field) for field in packed]).astype(np.float64)
    out_rows, depths = np.zeros(len(g), np.int32), np.zeros(len(g), np.float32)
    records = aligned_zeros(len(g))
    out = {"rows": out_rows, "records": records, "depths": depths}
    columns = (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh)

    def project(chosen: np.ndarray, threads: int = 1) -> int:
        return int(_core.project_rows(g, None, chosen, packed, view, None, out, threads))

    num = project(rows)
    visible = out_rows[:num].copy()
    ours = cheapest_ms(lambda: project(rows))
    plain = cheapest_ms(
        lambda: scalar.project(*map(pointer, columns), len(g), pointer(numbers), threshold, pointer(records))
    )
    seen = cheapest_ms(lambda: project(visible))
    order = np.zeros(num, np.int32)
    ordered = cheapest_ms(lambda: _core.order_splats(depths[:num], out_rows[:num], None, order, 1))
    return [
        row("project 2 M rows", num, ours, plain),
        row("project, only rows in view", num, seen),
        row("order by depth", num, ordered),
    ]


def frame_rows(scalar: ctypes.CDLL) -> list[dict[str, Any]]:
    """Lists and blending of 200 k Gaussians that fill the picture."""
    scene = st.Scene.flat(cloud(200_000, reach=1.0, scale=0.046, seed=1))
    camera = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=WIDTH, height=HEIGHT)
    frame = st.trace(scene, camera, select=LEAVES)
    splats, view = frame.splats, frame.view
    bins = cpu.bin.bin(splats, view)
    picture = cpu.blend.blend(splats, bins, view)
    binned = cheapest_ms(lambda: cpu.bin.bin(splats, view, threads=1))
    blended = cheapest_ms(lambda: cpu.blend.blend(splats, bins, view, threads=1))
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    lists = (pointer(splats.records), pointer(bins.tile_start), pointer(bins.splat_from_pair))
    size = (bins.num_tiles_x, bins.num_tiles_y, WIDTH, HEIGHT)
    plain = cheapest_ms(lambda: scalar.blend(*lists, *size, view.threshold, pointer(image)), repeat=3)
    assert st.psnr(image, picture.image) > 80, "the scalar loop draws another picture"
    return [
        row("bin 200 k splats", bins.num_pairs, binned),
        row("blend 960 × 540", bins.num_pairs, blended, plain) | {"evaluated": picture.num_evaluated},
    ]


def city_rows() -> list[dict[str, Any]]:
    """A whole frame of three chunks of a real city, harmonics of degree 3, all leaves."""
    folder = DATA / "trained" / "semarang_city"
    if not folder.is_dir():
        print("city: not measured, needs ../shared/data")
        return []
    scene = st.read([str(folder / f"5_{i}") for i in (4, 5, 9)])
    first = json.loads((DATA / "cameras" / "semarang_city_made_views.json").read_text())[0]
    pose = np.eye(4)
    pose[:3, :3] = np.array(first["rotation"]).T
    pose[:3, 3] = -pose[:3, :3] @ np.array(first["position"])
    K = np.array([[first["fx"], 0, first["width"] / 2], [0, first["fy"], first["height"] / 2], [0, 0, 1]])
    camera = st.Camera(pose, K, first["width"], first["height"]).scaled(WIDTH / first["width"])
    frame = st.trace(scene, camera, select=LEAVES)
    splats, bins, view = frame.splats, frame.bins, frame.view
    project = cpu.project.project
    stages = {
        "project and order": lambda: project(scene.gaussians, None, frame.selection.rows, view, threads=1),
        "bin": lambda: cpu.bin.bin(splats, view, threads=1),
        "blend": lambda: cpu.blend.blend(splats, bins, view, threads=1),
    }
    items = {"project and order": len(splats), "bin": bins.num_pairs, "blend": bins.num_pairs}
    return [row(f"city: {name}", items[name], cheapest_ms(work)) for name, work in stages.items()]


def row(stage: str, items: int, cpu_ms: float, scalar_ms: float | None = None) -> dict[str, Any]:
    """A line of the table; items are splats or pairs."""
    line: dict[str, Any] = {"stage": stage, "items": items, "CPU ms": cpu_ms, "ns an item": 1e6 * cpu_ms / items}
    if scalar_ms is not None:
        line |= {"scalar loop, CPU ms": scalar_ms, "times faster": scalar_ms / cpu_ms}
    return line


def cheapest_ms(work: Callable[[], Any], repeat: int = REPEAT) -> float:
    """CPU-milliseconds, the cheapest of several runs after one to warm up."""
    work()
    return 1e3 * measure(work, repeat=repeat).cpu_s


def cloud(n: int, *, reach: float, scale: float, seed: int) -> st.Gaussians:
    """Gaussians in front of a camera at the origin that looks along z, out to ``reach`` half pictures; depths 2 to 50."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(2, 50, n)
    half_y = np.tan(np.radians(25))
    x, y = (rng.uniform(-reach, reach, n) * depth * half for half in (half_y * WIDTH / HEIGHT, half_y))
    return st.Gaussians(
        np.stack([x, y, depth], axis=1).astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        (rng.normal(0, 0.6, (n, 3)) + np.log(scale)).astype(np.float32),
        rng.normal(0, 2, n).astype(np.float32),
        rng.normal(0, 0.3, (n, 1, 3)).astype(np.float32),
    )


def aligned_zeros(num_records: int) -> np.ndarray:
    """Records at a cache line, touched."""
    space = np.zeros(16 * num_records + 16, np.float32)
    skip = -space.ctypes.data % ALIGNED // 4
    return space[skip : skip + 16 * num_records].reshape(num_records, 16)


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def compile_scalar() -> ctypes.CDLL:
    """The plain loops of scalar_render.cpp, at the compiler's -O3 but one value at a time."""
    source = Path(__file__).with_name("scalar_render.cpp")
    target = Path(tempfile.mkdtemp()) / "scalar_render.so"
    flags = [
        "-std=c++17",
        "-O3",
        "-fno-tree-vectorize",
        "-fno-tree-slp-vectorize",
        "-fno-math-errno",
        "-shared",
        "-fPIC",
    ]
    subprocess.run(["c++", *flags, str(source), "-o", str(target)], check=True)
    library = ctypes.CDLL(str(target))
    p, i, f = ctypes.c_void_p, ctypes.c_int, ctypes.c_float
    library.project.argtypes = [p, p, p, p, p, ctypes.c_int64, p, f, p]
    library.project.restype = ctypes.c_int64
    library.blend.argtypes = [p, p, p, i, i, i, i, f, p]
    library.blend.restype = None
    return library


if __name__ == "__main__":
    main()
