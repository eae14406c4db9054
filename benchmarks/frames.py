"""What a frame takes, stage by stage: seven kinds of views, four choices of nodes, three sizes, one thread and two.

``python benchmarks/frames.py [CITY.splatree]`` needs the shared city, with levels as ``splatree build`` makes them; without the
file they are built first, in 30 processor seconds. `leaves` draws all leaves; `40 dB` and `33 dB` draw the coarsest cut with
this PSNR against them, found by drawing; the last choice is a budget. Figures are medians of some frames.

- *select* to *blend*: a frame alone, one thread.
- *alone*, *alone, 2 threads*: all stages of it.
- *next*: the frame after it in one session, from a camera that has turned by a degree, two threads; *next / alone* compares it
  with that same view drawn alone.
- *moving*, *moving / alone*: the same as a frame of a camera that moves (render/moving.py), while its cut is kept.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import splatree as st
from harness import DATA, measure, save, table

CITY = DATA / "trained" / "semarang_city"
VIEWS = DATA / "cameras" / "semarang_city_made_views.json"
CITY_VIEWS = {"far": "far_00", "high": "flight_00", "orbit": "orbit_00", "middle": "flight_08", "low": "flight_15"}
"""All of the city; from 180 m; round a stadium; from 115 m; from 50 m."""
OBJECTS = {"robot": DATA / "trained" / "playbot" / "0_0", "biker": DATA / "formats" / "biker.compressed.ply"}
"""Objects that fill the picture: of 500,000 and of 150,000 Gaussians, the second without harmonics."""
BUDGET = 200_000
QUALITIES_DB = (40.0, 33.0)
COARSEST_PX, FINEST_PX = 64.0, 1.7
PRECISION = 1.06
"""τ_R is found to this factor."""
TURN_DEG = 1.0
LEAVES = st.SelectOptions(pixel_error=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, nargs="?")
    parser.add_argument("--views", nargs="+", choices=[*OBJECTS, *CITY_VIEWS], default=[*OBJECTS, *CITY_VIEWS])
    parser.add_argument("--heights", nargs="+", type=int, default=[360, 720, 1080], help="of pictures, px")
    parser.add_argument("--repeat", type=int, default=3, help="frames of each kind")
    arguments = parser.parse_args()
    if not all(path.exists() for path in (CITY, VIEWS, *OBJECTS.values())):
        raise SystemExit(f"needs the city at {CITY}, its views at {VIEWS} and objects at {list(OBJECTS.values())}")
    views = {camera.name: camera for camera in st.read_cameras(VIEWS)}
    city = st.read(arguments.city) if arguments.city else st.build_lod(st.read(sorted(CITY.glob("5_*"))))
    rows: list[dict[str, Any]] = []
    for kind in arguments.views:
        scene = city if kind in CITY_VIEWS else st.build_lod(st.read(OBJECTS[kind]))
        camera = views[CITY_VIEWS[kind]] if kind in CITY_VIEWS else near_view(scene)
        for height in arguments.heights:
            sized = camera.scaled(height / camera.height)
            for drawn, select in choices(scene, sized):
                rows.append(
                    {"view": kind, "px": height, "drawn": drawn, **costs_of(scene, sized, select, arguments.repeat)}
                )
                print(f"{kind} {height} {drawn}", flush=True)
        save(
            "frames",
            rows,
            about=f"Processor milliseconds of a frame, medians of {arguments.repeat}: a city of {city.tree.num_leaves:,} leaves, "
            "a robot of 500,000 and a biker of 150,000. `select` to `alone` are of one thread; `next` is the frame after it in "
            "one session, `moving` the same while the camera moves",
        )
    print(table(rows))


def choices(scene: st.Scene, camera: st.Camera) -> Iterator[tuple[str, st.SelectOptions]]:
    """Leaves; of each quality the coarsest cut, all leaves where no cut of merged nodes has it; and a budget."""
    yield "leaves", LEAVES
    with st.open_session(scene) as session:
        leaves = np.clip(session.draw(camera, select=LEAVES).image, 0, 1)

        def quality_at(pixel_error: float) -> float:
            drawn = session.draw(camera, select=st.SelectOptions(pixel_error=pixel_error))
            return st.psnr(np.clip(drawn.image, 0, 1), leaves)

        fine = FINEST_PX
        for quality in QUALITIES_DB:
            coarse = COARSEST_PX
            while coarse > PRECISION * fine:
                between = math.sqrt(fine * coarse)
                fine, coarse = (between, coarse) if quality_at(between) >= quality else (fine, between)
            yield f"{quality:g} dB", st.SelectOptions(pixel_error=fine if fine > FINEST_PX else 0.0)
    yield f"{BUDGET:,} nodes", st.SelectOptions(budget=BUDGET)


def costs_of(scene: st.Scene, camera: st.Camera, select: st.SelectOptions, repeat: int) -> dict[str, Any]:
    """The costs of one view."""
    turned = turned_by(camera, TURN_DEG)
    alone = [st.render(scene, camera, select=select, threads=1) for _ in range(repeat)]
    stages = {stage: median(r.cpu_milliseconds[stage] for r in alone) for stage in alone[0].cpu_milliseconds}
    both = median_ms(partial(st.render, scene, camera, select=select, threads=2), repeat)
    after = median_ms(partial(st.render, scene, turned, select=select, threads=2), repeat)
    with st.open_session(scene, select=select, threads=2) as session:
        following = median_ms(partial(session.draw, turned), repeat, before=partial(session.draw, camera))
        motion = session.motion()
        for _ in range(4):  # the cut is kept from now on, and its columns are gathered
            motion.draw(camera)
        moving = median_ms(partial(motion.draw, turned), repeat, before=partial(motion.draw, camera))
    counts = {"nodes": alone[0].counters.num_selected, "pairs": alone[0].counters.num_pairs}
    all_stages = {"alone": sum(stages.values()), "alone, 2 threads": both}
    ratios = {"next / alone": following / after, "moving": moving, "moving / alone": moving / after}
    return {"τ_R": select.pixel_error, **counts, **stages, **all_stages, "next": following, **ratios}


def median_ms(work: Callable[[], Any], repeat: int, before: Callable[[], Any] | None = None) -> float:
    """Processor milliseconds of a call, after another that is not measured."""
    costs = []
    for _ in range(repeat):
        if before is not None:
            before()
        costs.append(1e3 * measure(work).cpu_s)
    return median(costs)


def turned_by(camera: st.Camera, degrees: float) -> st.Camera:
    """The camera turned about its own vertical."""
    angle = math.radians(degrees)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = math.cos(angle), -math.sin(angle), math.sin(angle), math.cos(angle)
    return replace(camera, camera_from_world=turn @ camera.camera_from_world)


def near_view(scene: st.Scene) -> st.Camera:
    """An object that fills the picture."""
    return st.orbit(scene, st.PathOptions(views=1, width=1280, height=720))[0]


if __name__ == "__main__":
    main()
