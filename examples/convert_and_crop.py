"""Turn a scene, cut a ball out of it and write it as .splat: ``python examples/convert_and_crop.py in.ply out.splat``."""

import sys
from importlib.resources import files

import splatree as st

source = sys.argv[1] if len(sys.argv) > 1 else str(files("splatree") / "data" / "semarang_5_9.sog")
target = sys.argv[2] if len(sys.argv) > 2 else "cropped.splat"

# 3DGS scenes have y down; many viewers want it up: half a turn about x. Then keep what is opaque and near the middle.
edits = st.EditOptions(rotate=(180.0, 0.0, 0.0), min_opacity=0.05, crop_sphere=(204.0, -3.0, -376.0, 60.0))
done = st.convert(source, target, st.ConvertOptions(edit=edits), force=True)
print(f"{target}: {done.num_written:,} of {done.num_read:,} Gaussians")
for sentence in done.lost:
    print("lost:", sentence)

# The same on a scene in memory.
scene = st.edit(st.read(source), edits)
print(f"in memory: {len(scene):,} Gaussians of degree {scene.gaussians.sh_degree}")
