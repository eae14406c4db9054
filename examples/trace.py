"""Look inside a frame: what each stage leaves behind, and which tile of the picture takes the most work."""

from importlib.resources import as_file, files

import numpy as np

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.build_lod(st.read(path))

camera = st.flyout(scene, st.PathOptions(views=1, width=640, height=360), nearest=1, farthest=1)[0]
frame = st.trace(scene, camera)

depth = scene.tree.depth[frame.selection.rows]
print(f"selection: {len(frame.selection):,} rows at depths {np.bincount(depth).tolist()}")
print(f"splats: {len(frame.splats):,}, nearest row {frame.splats.rows[frame.splats.order[0]]}")

pairs = np.diff(frame.bins.tile_start).reshape(frame.bins.num_tiles_y, frame.bins.num_tiles_x)
y, x = np.unravel_index(np.argmax(pairs), pairs.shape)
print(f"bins: {frame.bins.num_pairs:,} pairs; the fullest tile is in row {y}, column {x}, with {pairs[y, x]:,} splats")

counters = frame.result.counters
print(
    f"blend: {counters.num_evaluated:,} evaluations, {counters.num_blended:,} blended; alpha {frame.result.alpha.mean():.2f}"
)
