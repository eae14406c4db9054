"""What a frame takes, stage by stage: seven kinds of views, four choices of nodes, three sizes, one thread and two.

``python benchmarks/frames.py [CITY.splatree]`` needs the shared city, with levels as ``splatree build`` makes them; without the
file they are built first, in 30 processor seconds. `leaves` draws all leaves; `40 dB` and `33 dB` draw the coarsest cut with
this PSNR against them, found by drawing; the last choice is a budget. Figures are those of the cheapest of some frames.

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
    parser.add_argument("--repeat", type=int, default=5, help="frames of each kind")
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
            about=f"Processor milliseconds of a frame, cheapest of {arguments.repeat}: a city of {city.tree.num_leaves:,} leaves"
            ", a robot of 500,000 and a biker of 150,000. `select` to `alone` are of one thread; `next` is the frame after it in "
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
    """The costs of one view: all kinds of frames take turns ``repeat`` times, and the cheapest of each counts."""
    turned = turned_by(camera, TURN_DEG)
    alone = partial(st.render, scene, select=select)
    with st.open_session(scene, select=select, threads=2) as session:
        motion = session.motion()
        for _ in range(4):  # the cut is kept from now on, and its columns are gathered
            motion.draw(camera)
        first: list[st.RenderResult] = []
        rounds: list[dict[str, float]] = []
        for _ in range(repeat):
            first.append(alone(camera, threads=1))
            ms = {"alone, 2 threads": ms_of(partial(alone, camera, threads=2))}
            ms["turned"] = ms_of(partial(alone, turned, threads=2))
            session.draw(camera)
            ms["next"] = ms_of(partial(session.draw, turned))
            motion.draw(camera)
            ms["moving"] = ms_of(partial(motion.draw, turned))
            rounds.append(ms)
    stages = min((frame.cpu_milliseconds for frame in first), key=lambda ms: sum(ms.values()))
    least = {kind: min(ms[kind] for ms in rounds) for kind in rounds[0]}
    turned_ms = least.pop("turned")
    return {
        "τ_R": select.pixel_error,
        "nodes": first[0].counters.num_selected,
        "pairs": first[0].counters.num_pairs,
        **stages,
        "alone": sum(stages.values()),
        **least,
        "next / alone": least["next"] / turned_ms,
        "moving / alone": least["moving"] / turned_ms,
    }


def ms_of(work: Callable[[], Any]) -> float:
    """Processor milliseconds of a call."""
    return 1e3 * measure(work).cpu_s


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
