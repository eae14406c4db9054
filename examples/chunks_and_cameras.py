"""Read several files as one scene, keep it with its levels, and keep the cameras that look at it."""

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.read(path)

# Large captures arrive in pieces; a folder of them is one scene.
folder = Path("chunks")
folder.mkdir(exist_ok=True)
half = len(scene) // 2
for i, rows in enumerate((np.arange(half), np.arange(half, len(scene)))):
    st.write(st.Scene.flat(scene.gaussians.take(rows)), folder / f"chunk_{i}.ply", force=True)
city = st.read(folder)
print(f"{len(city):,} Gaussians from {', '.join(Path(p).name for p in city.source.paths)}")

# The native file keeps the levels and opens without a copy; a format without levels gets a cut of the tree.
tree = st.build_lod(city)
st.write(tree, "city.splatree", force=True)
st.write(tree, "coarse.splat", force=True, depth=2)
tree = st.read("city.splatree")
print(f"{len(tree):,} nodes in {tree.tree.num_levels} levels; {len(st.read('coarse.splat')):,} at depth 2 or above")

# Cameras of INRIA, COLMAP and nerfstudio are read by the same function; these are written in INRIA's JSON.
views = st.Cameras(
    tuple(st.Camera.look_at([230, -60 - 20 * i, 250], [215, 0, 370], width=320, height=180) for i in range(3))
)
st.write_cameras(views, "cameras.json", force=True)
for i, camera in enumerate(st.read_cameras("cameras.json")):
    st.write_image(st.render(tree, camera).image, f"view_{i}.png", force=True)
print(f"the last picture has mean {st.read_image('view_2.png').mean():.3f}")
