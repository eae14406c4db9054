"""Choose how much to draw: by the error on the screen, or by a budget of nodes, while the camera moves away."""

from importlib.resources import as_file, files

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.build_lod(st.read(path))

cameras = st.flyout(scene, st.PathOptions(views=4, width=480, height=270, elevation_deg=40))
for name, select in {
    "3 px": st.SelectOptions(pixel_error=3),
    "8 px": st.SelectOptions(pixel_error=8),
    "25,000 nodes": st.SelectOptions(budget=25_000),
}.items():
    for evaluation in st.evaluate(scene, cameras, select=select):
        cut, leaves = evaluation.cut, evaluation.leaves
        print(
            f"{name:>12}: {len(cut.selection):7,} of {len(leaves.selection):7,} nodes at τ = {cut.selection.pixel_error:.1f} px, "
            f"{evaluation.cut_vs_leaves.psnr:.1f} dB against all leaves"
        )
