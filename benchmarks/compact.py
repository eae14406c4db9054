"""Compact ``.splatree`` files: their bytes beside the SOG that a scene came from, and their pictures beside the exact ones.

``python benchmarks/compact.py [scene]``; without a scene, one chunk of the shared city, as PlayCanvas' own tool wrote it. Levels
are made by pairs and by a radius. Twelve views look at the scene from four distances, at three pixel errors: the least PSNR of
each pixel error is shown, against the exact file at the same pixel error.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import splatree as st
from harness import DATA, measure, save, table
from splatree.io.registry import stored_bytes

CHUNK = DATA / "trained" / "semarang_city" / "5_9"
DISTANCES = (0.5, 1.0, 2.0, 4.0)
"""Distances of the views, in half diagonals of the box that holds the middle 90 % of the means along each axis."""
PIXEL_ERRORS = (0.0, 1.0, 3.0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path, nargs="?", default=CHUNK)
    source = parser.parse_args().scene
    flat, source_bytes = st.read(source), stored_bytes(source)
    rows = []
    for method in ("pairs", "radius"):
        tree = st.build_lod(flat, st.BuildOptions(method=method))
        with tempfile.TemporaryDirectory() as folder:
            exact, compact = Path(folder) / "exact.splatree", Path(folder) / "compact.splatree"
            st.write(tree, exact)
            options = st.WriteOptions(compact=True)
            writing = measure(
                lambda tree=tree, compact=compact, options=options: st.write(tree, compact, options=options)
            )
            reading = measure(lambda compact=compact: st.read(compact))
            rows.append(
                {
                    "levels by": method,
                    "Gaussians": len(flat),
                    "nodes": len(tree),
                    "exact / SOG": exact.stat().st_size / source_bytes,
                    "compact / SOG": compact.stat().st_size / source_bytes,
                    **{f"dB at {e:g} px": worst(tree, reading.value, e) for e in PIXEL_ERRORS},
                    "write, CPU s": writing.cpu_s,
                    "read, CPU s": reading.cpu_s,
                }
            )
    print(table(rows))
    save("compact", rows, about="Compact .splatree files against the SOG that the scene came from.")


def worst(exact: st.Scene, compact: st.Scene, pixel_error: float) -> float:
    """The least PSNR of twelve views."""
    low, high = np.quantile(exact.gaussians.means, [0.05, 0.95], axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    options = st.SelectOptions(pixel_error=pixel_error)
    found = []
    for distance in DISTANCES:
        for angle in np.radians([0, 120, 240]):
            eye = middle + distance * reach * np.array([np.cos(angle), -0.6, np.sin(angle)])
            camera = st.Camera.look_at(eye, middle, width=640, height=480)
            pictures = [st.render(scene, camera, select=options).image for scene in (exact, compact)]
            found.append(float(st.psnr(*pictures)))
    return min(found)


if __name__ == "__main__":
    main()
