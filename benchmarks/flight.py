"""How many pages a camera that flies over a scene on disk waits for, with and without loading the pages of its next view beside.

``python benchmarks/flight.py --store city.splatree [--view 15] [--steps 20] [--metres 3]`` needs a folder of parts of the shared
city. The camera of a made view flies to its right, so many metres a step, and draws 640 × 360 pixels. What is loaded beside
has the time that it needs. *Waited for* are pages that were loaded when a picture needed them, *ahead* those that were loaded
beside. The first view is not counted.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from unittest import mock

import splatree as st
from harness import DATA, save, table
from splatree.io.cameras.files import read_cameras

VIEWS = DATA / "cameras" / "semarang_city_made_views.json"


def flight(camera: st.Camera, steps: int, metres: float) -> list[st.Camera]:
    """The camera at each step."""
    right = camera.camera_from_world[0, :3]
    poses = []
    for step in range(steps + 1):
        pose = camera.camera_from_world.copy()
        pose[:3, 3] -= pose[:3, :3] @ (right * metres * step)
        poses.append(replace(camera, camera_from_world=pose))
    return poses


def row_of(folder: Path, cameras: list[st.Camera], *, looks_ahead: bool) -> dict[str, object]:
    """One flight, from a store that is opened anew."""
    with (
        mock.patch.object(st.Store, "prefetch", st.Store.prefetch if looks_ahead else lambda *_: None),
        st.open_store(folder, max_memory="64G") as store,
        st.open_session(store) as session,
    ):
        session.draw(cameras[0])
        first = store.num_loaded
        for camera in cameras[1:]:
            session.draw(camera)
            if store._ahead is not None:
                store._ahead[1].result()
        counts = {"waited for": store.num_loaded - first, "ahead": store.num_ahead}
    return {"looks ahead": "yes" if looks_ahead else "no", **counts}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--view", type=int, default=15)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--metres", type=float, default=3.0)
    arguments = parser.parse_args()
    camera = list(read_cameras(VIEWS))[arguments.view].resized(640, 360)
    cameras = flight(camera, arguments.steps, arguments.metres)
    rows = [row_of(arguments.store, cameras, looks_ahead=ahead) for ahead in (False, True)]
    print(table(rows))
    save("flight", rows, about="Pages that a camera waits for that flies over a city on disk")


if __name__ == "__main__":
    main()
