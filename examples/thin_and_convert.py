"""Make a scene a tenth of its size: Gaussians that are close and alike are merged, not dropped; then write it as .ply."""

from importlib.resources import as_file, files
from pathlib import Path

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.read(path)

thinned = st.thin(scene, st.ThinOptions(keep=0.1))
print(f"{len(thinned):,} of {len(scene):,} Gaussians are left after {thinned.groups.rounds} rounds")

st.write(thinned.scene, "tenth.ply", force=True)
print(f"tenth.ply: {Path('tenth.ply').stat().st_size / 2**20:.1f} MiB")

# How near is it? The same view of both, compared.
camera = st.orbit(scene, st.PathOptions(views=1, width=480, height=270))[0]
full, tenth = (st.render(s, camera).image.clip(0, 1) for s in (scene, thinned.scene))
print(f"PSNR {st.psnr(tenth, full):.1f} dB, SSIM {st.ssim(tenth, full):.3f} from afar")
