"""What a frame takes, stage by stage: six kinds of views, three qualities, three sizes, one thread and two.

``python benchmarks/frames.py [CITY.splatree]`` needs the shared city, with levels as ``splatree build`` makes them; without the
file they are built first, in 30 processor seconds. `leaves` draws all leaves; `40 dB` and `33 dB` draw the coarsest cut with
this PSNR against them, found by drawing. Each figure is the median of three frames.

- *select* to *blend*: a frame alone, one thread.
- *alone*, *alone, 2 threads*: all stages of it.
- *next*: the frame after it in one session, from a camera that has turned by a degree, two threads; *next / alone* compares it
  with that same view drawn alone.
- *moving*, *moving / alone*: the same as the next frame of a camera that moves (render/moving.py).
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
OBJECT = DATA / "trained" / "playbot" / "0_0"
HEIGHTS_PX = (360, 720, 1080)
QUALITIES_DB = (40.0, 33.0)
COARSEST_PX, FINEST_PX = 64.0, 1.7
PRECISION = 1.06
"""τ_R is found to this factor."""
REPEAT = 3
TURN_DEG = 1.0
LEAVES = st.SelectOptions(pixel_error=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, nargs="?")
    arguments = parser.parse_args()
    if not CITY.is_dir() or not VIEWS.is_file() or not OBJECT.is_dir():
        raise SystemExit(f"needs the city at {CITY}, its views at {VIEWS} and the robot at {OBJECT}")
    views = {camera.name: camera for camera in st.read_cameras(VIEWS)}
    rows = [row for robot in [st.build_lod(st.read(OBJECT))] for row in rows_of("object", robot, near_view(robot))]
    city = st.read(arguments.city) if arguments.city else st.build_lod(st.read(sorted(CITY.glob("5_*"))))
    for kind, name in CITY_VIEWS.items():
        rows += rows_of(kind, city, views[name])
    print(table(rows))
    save(
        "frames",
        rows,
        about=f"Processor milliseconds of a frame, medians of {REPEAT}: a city of {city.tree.num_leaves:,} leaves, and a robot "
        f"of {robot.tree.num_leaves:,}. `select` to `alone` are of one thread; `next` is the frame after it in one session, "
        "`moving` the same while the camera moves",
    )


def rows_of(kind: str, scene: st.Scene, camera: st.Camera) -> Iterator[dict[str, Any]]:
    """A line for each size and quality."""
    with st.open_session(scene) as session:
        for height in HEIGHTS_PX:
            sized = camera.scaled(height / camera.height)
            for name, pixel_error in pixel_errors(session, sized):
                yield row_of(
                    scene, sized, st.SelectOptions(pixel_error=pixel_error), {"view": kind, "px": height, "drawn": name}
                )
                print(f"{kind} {height} {name}", flush=True)


def pixel_errors(session: st.Session, camera: st.Camera) -> Iterator[tuple[str, float]]:
    """The largest τ_R of each quality: 0, all leaves, where no cut of merged nodes has it."""
    leaves = np.clip(session.draw(camera, select=LEAVES).image, 0, 1)

    def loss_at(pixel_error: float) -> float:
        drawn = session.draw(camera, select=st.SelectOptions(pixel_error=pixel_error))
        return st.psnr(np.clip(drawn.image, 0, 1), leaves)

    yield "leaves", 0.0
    fine = FINEST_PX
    for quality in QUALITIES_DB:
        coarse = COARSEST_PX
        while coarse > PRECISION * fine:
            between = math.sqrt(fine * coarse)
            fine, coarse = (between, coarse) if loss_at(between) >= quality else (fine, between)
        yield f"{quality:g} dB", fine if fine > FINEST_PX else 0.0


def row_of(scene: st.Scene, camera: st.Camera, select: st.SelectOptions, named: dict[str, Any]) -> dict[str, Any]:
    """The costs of one view."""
    turned = turned_by(camera, TURN_DEG)
    alone = [st.render(scene, camera, select=select, threads=1) for _ in range(REPEAT)]
    stages = {stage: median(r.cpu_milliseconds[stage] for r in alone) for stage in alone[0].cpu_milliseconds}
    both = median_ms(partial(st.render, scene, camera, select=select, threads=2))
    after = median_ms(partial(st.render, scene, turned, select=select, threads=2))
    with st.open_session(scene, select=select, threads=2) as session:
        following = median_ms(partial(session.draw, turned), before=partial(session.draw, camera))
        motion = session.motion()
        motion.draw(camera)
        moving = median_ms(partial(motion.draw, turned), before=partial(motion.draw, camera))
    counts = {"τ_R": select.pixel_error, "nodes": alone[0].counters.num_selected, "pairs": alone[0].counters.num_pairs}
    all_stages = {"alone": sum(stages.values()), "alone, 2 threads": both}
    ratios = {"next / alone": following / after, "moving": moving, "moving / alone": moving / after}
    return {**named, **counts, **stages, **all_stages, "next": following, **ratios}


def median_ms(work: Callable[[], Any], before: Callable[[], Any] | None = None) -> float:
    """Processor milliseconds of a call, after another that is not measured."""
    costs = []
    for _ in range(REPEAT):
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
