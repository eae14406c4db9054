"""Publish a scene: levels of detail, a stream for web viewers, a server, and a report of its quality."""

from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory

import splatree as st

with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
    scene = st.read(path)
scene = st.build_lod(st.edit(scene, st.EditOptions(sh_degree=0)), st.BuildOptions(method="pairs"))

with TemporaryDirectory() as folder:
    written = st.stream(scene, Path(folder) / "city")
    print(f"{written.num_chunks} chunks, {written.num_parts} parts, {written.bytes / 1e6:.1f} MB")
    for level in written.levels:
        print(f"  level {level.level}: {level.num_nodes:,} Gaussians, {level.bytes / 1e6:.2f} MB")

    # What PlayCanvas would load in three views, and how near its picture comes to all Gaussians.
    report = st.report_stream(scene, written, budgets=[60_000])
    for view in report.views:
        print(f"  {view.view}: {view.num_nodes:,} Gaussians, {view.bytes / 1e6:.2f} MB, {view.psnr_db:.1f} dB")

    # `splatree serve` does the same and waits; open the address in a browser.
    with st.serve(written.output, st.ServeOptions(port=0)) as server:
        print("served at", server.address)
