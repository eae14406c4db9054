"""An aerial frame at 720p, classic beside antialiased: nodes, processor time, and how near each is to the true picture.

``python benchmarks/aerial.py [--chunks 5_4 5_5 5_9] [--quality 33]`` needs the shared city. The truth is the mean of 4 × 4 pixels
of all leaves drawn at four times the size. Levels by pairs are built for each mode. *cut*: that of the quality against all leaves
in the same mode. *as near*: the coarsest antialiased cut whose PSNR to the truth is not below that of all leaves in classic
mode. A time is that of the cheapest of three frames for a τ_R that is known.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import splatree as st
from harness import DATA, save, table

ELEVATION_DEG = 50.0
DISTANCES = (1.0, 1.6)
SUPERSAMPLED = 4
TAUS_PX = tuple(2 * 2 ** (i / 4) for i in range(20))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", nargs="+", default=["5_4", "5_5", "5_9"])
    parser.add_argument("--quality", type=float, default=33.0)
    arguments = parser.parse_args()
    city = st.read([str(DATA / "trained" / "semarang_city" / chunk) for chunk in arguments.chunks])
    path = st.PathOptions(views=1, width=1280, height=720, elevation_deg=ELEVATION_DEG)
    views = {away: st.flyout(city, path, nearest=away, farthest=away)[0] for away in DISTANCES}
    truths = {away: truth_of(city, view) for away, view in views.items()}
    rows: list[dict[str, object]] = []
    floor: dict[float, float] = {}
    for mode in ("classic", "antialiased"):
        with st.open_session(st.build_lod(replace(city, mode=mode), st.BuildOptions("pairs"))) as session:
            for away, view in views.items():
                for kind, row in drawn(session, view, truths[away], arguments.quality, floor.get(away)):
                    floor.setdefault(away, float(str(row["dB to the truth"])))
                    rows.append({"distance": away, "mode": mode, "drawn": kind} | row)
                    print(rows[-1], flush=True)
    print(table(rows))
    save("aerial", rows, about="An aerial frame at 720p in both modes, against the supersampled picture")


def truth_of(scene: st.Scene, view: st.Camera) -> np.ndarray:
    """The supersampled picture."""
    large = st.render(scene, view.scaled(SUPERSAMPLED), select=st.SelectOptions(pixel_error=0.0)).image
    shape = (view.height, SUPERSAMPLED, view.width, SUPERSAMPLED, 3)
    return np.clip(large, 0, 1).reshape(shape).mean(axis=(1, 3), dtype=np.float64)


def drawn(
    session: st.Session, view: st.Camera, truth: np.ndarray, quality: float, floor: float | None
) -> Iterator[tuple[str, dict[str, object]]]:
    """A line for all leaves, for the cut of the quality, and for the coarsest cut that is ``floor`` dB from the truth."""
    leaves = session.draw(view, select=st.SelectOptions(pixel_error=0.0)).image.clip(0, 1)
    found = session.select(view, select=st.SelectOptions(quality=quality)).pixel_error
    ways = {"leaves": 0.0, f"cut of {quality:g} dB": found}
    if floor is not None:
        near = [tau for tau in TAUS_PX if st.psnr(shown(session, view, tau), truth) >= floor]
        ways |= {"cut as near as classic leaves": near[-1]} if near else {}
    for kind, tau in ways.items():
        results = [session.draw(view, select=st.SelectOptions(pixel_error=tau)) for _ in range(3)]
        image = results[0].image.clip(0, 1)
        yield (
            kind,
            {
                "τ_R, px": tau,
                "nodes in view": results[0].counters.num_selected,
                "CPU ms": min(sum(result.cpu_milliseconds.values()) for result in results),
                "dB to leaves": min(st.psnr(image, leaves), 60.0),
                "dB to the truth": st.psnr(image, truth),
            },
        )


def shown(session: st.Session, view: st.Camera, tau: float) -> np.ndarray:
    """What a screen shows of a cut."""
    return session.draw(view, select=st.SelectOptions(pixel_error=tau)).image.clip(0, 1)


if __name__ == "__main__":
    main()
