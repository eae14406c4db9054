"""Draw one picture of the bundled scene: read, build levels of detail, look, render, save."""

from importlib.resources import as_file, files

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.build_lod(st.read(path))

# The scene is in metres with y down; this looks at a crossroads from above the roofs.
camera = st.Camera.look_at([230, -60, 250], [215, 0, 370], width=640, height=360)
result = st.render(scene, camera)
st.write_image(result.image, "crossroads.png", force=True)

counters = result.counters
print(f"{counters.num_selected:,} of {len(scene):,} nodes, {counters.num_pairs:,} pairs of splat and tile")
print(", ".join(f"{stage} {ms:.1f} ms" for stage, ms in result.milliseconds.items()))
