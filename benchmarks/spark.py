"""Cuts of our levels against the levels that Spark makes itself, at equal visible nodes.

``python benchmarks/spark.py [--scenes ...] [--shares 5 20 50]`` needs the shared scenes, Chromium and npm; if one is missing
it says so and stops. Spark builds levels of detail in the browser, by its methods `tiny` and `quality`, in a worker that is
compiled Rust. A page in headless Chromium has it do that, with 32 bytes a splat, and hands out nodes and tree. Of that tree,
each view draws what Spark chooses (`splatree.stream.readers.spark`) within a share of the leaves; the cuts of our levels get
as many nodes in view as a budget. All pictures are drawn by the library and compared with that of all leaves.

Scenes are without harmonics beyond the DC. A node of an opacity above 1 is drawn as our reader of ``.rad`` draws it: the Gaussian
with the same peak and area as Spark's plateau.
"""

import argparse
import base64
import functools
import http.server
import math
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

import splatree as st
from harness import ROOT, save, table
from levels import BEST_DB, SCENES, picture, views_of
from splatree.constants import SH_C0
from splatree.errors import InputError
from splatree.io.opacities import areas_of_powers, logits_from_opacities
from splatree.maths.forests import preorder_from_links
from splatree.scene.thinning import Method
from splatree.stream.readers.spark import select_spark

sys.path.insert(0, str(ROOT / "tests" / "browser"))
from chromium import Page, chromium, find_chromium

import peers

METHODS = {"tiny": "false", "quality": "true"}
PAGE = """<!doctype html><link rel="icon" href="data:,"><script type="importmap">{"imports": {
"three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/",
"@sparkjsdev/spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
import { ExtSplats } from '@sparkjsdev/spark';
window.make = async (quality) => {
  const fileBytes = new Uint8Array(await (await fetch('/leaves.ply')).arrayBuffer());
  const leaves = new ExtSplats({ fileBytes, fileName: 'leaves.ply' });
  await leaves.initialized;
  await leaves.createLodSplats({ quality });
  const lod = leaves.lodSplats;
  await lod.initialized;
  const rows = new Float32Array(14 * lod.numSplats);
  for (let i = 0; i < lod.numSplats; i++) {
    const { center: c, scales: s, quaternion: q, opacity, color } = lod.getSplat(i);
    rows.set([c.x, c.y, c.z, q.w, q.x, q.y, q.z, s.x, s.y, s.z, opacity, color.r, color.g, color.b], 14 * i);
  }
  window.made = { rows, tree: lod.extra.lodTree.slice(0, 4 * lod.numSplats) };
  return lod.numSplats;
};
window.part = (name, begin, end) => {  // bytes as text
  const bytes = new Uint8Array(window.made[name].buffer, window.made[name].byteOffset, window.made[name].byteLength);
  let text = '';
  for (let i = begin; i < Math.min(end, bytes.length); i += 8192) {
    text += String.fromCharCode(...bytes.subarray(i, Math.min(i + 8192, end)));
  }
  return btoa(text);
};
window.isReady = true;
</script>"""
PART_BYTES = 1 << 22


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """A folder at an address of this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        server.shutdown()


def spark_tree(page: Page, quality: str) -> tuple[st.Scene, st.Scene]:
    """The levels that Spark makes of the leaves that the page loads: sizes by which it chooses nodes, and nodes to draw."""
    n = int(page.evaluate(f"window.make({quality})", timeout=1800))

    def column(name: str, dtype: str, width: int) -> np.ndarray:
        size = 4 * width * n
        parts = [
            base64.b64decode(page.evaluate(f"window.part('{name}', {begin}, {min(begin + PART_BYTES, size)})"))
            for begin in range(0, size, PART_BYTES)
        ]
        return np.frombuffer(b"".join(parts), dtype).reshape(n, width)

    rows, links = column("rows", "<f4", 14), column("tree", "<u4", 4)
    num_children, first_child = (links[:, 2] & 0xFFFF).astype(np.int32), links[:, 3].astype(np.int64)
    order = preorder_from_links(first_child, num_children, np.array([0]))
    rows = rows[order.node_from_row]
    log_scales, opacities = np.log(np.maximum(rows[:, 7:10], 1e-12)), rows[:, 10]
    plateau = np.minimum(4 * np.maximum(opacities.astype(np.float64), 1) - 3, 5)
    sizes = log_scales + np.log(plateau)[:, None]
    log_scales += (0.5 * np.log(areas_of_powers(np.exp((plateau**2 - 1) / math.e))))[:, None]
    logits = logits_from_opacities(opacities, step_low=2.0**-24, step_high=2.0**-11)
    dc = ((rows[:, 11:14] - 0.5) / SH_C0)[:, None, :]
    columns = [rows[:, :3], rows[:, 3:7], log_scales, logits, dc]
    gaussians = st.Gaussians(*(np.ascontiguousarray(c, np.float32) for c in columns))
    tree = st.GaussianTree(order.subtree_end, order.depth, np.zeros(n, np.float32))
    return st.Scene(replace(gaussians, log_scales=sizes.astype(np.float32)), tree), st.Scene(gaussians, tree)


def compared(
    name: str, flat: st.Scene, peers_levels: dict[str, tuple[st.Scene, st.Scene]], shares: list[float]
) -> Iterator[dict[str, object]]:
    """A row for each method of Spark, share and view."""
    trees = {method: st.build_lod(flat, st.BuildOptions(method)) for method in get_args(Method)}
    for key, view in views_of(flat).items():
        truth = picture(flat, view, None)[0]
        for (spark, (sizes, nodes)), share in ((item, share) for item in peers_levels.items() for share in shares):
            chosen = select_spark(sizes, view, int(share / 100 * len(flat)))
            drawn = st.Scene.flat(nodes.gaussians.take(chosen.drawn), mode=flat.mode)
            image, budget = picture(drawn, view, None)
            found = min(st.psnr(image, truth), BEST_DB)
            row: dict[str, object] = {"scene": name, "Spark's levels": spark, "share, %": share, "view": key}
            row |= {"visible nodes": budget, "Spark, dB": found}
            for method, tree in trees.items():
                try:
                    psnr = min(st.psnr(picture(tree, view, budget)[0], truth), BEST_DB)
                except InputError:  # more roots are in view than Spark draws nodes
                    row |= {f"cut, {method}, dB": "", f"{method} − Spark": ""}
                    continue
                row |= {f"cut, {method}, dB": psnr, f"{method} − Spark": psnr - found}
            yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["biker", "city 5_9", "block"])
    parser.add_argument("--shares", nargs="+", type=float, default=[5, 20, 50])
    arguments = parser.parse_args()
    if find_chromium() is None:
        sys.exit("Chromium is not installed, in which Spark makes its levels")
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        packages, reason = peers.install(folder)
        if packages is None:
            sys.exit(reason)
        if packages != folder / "node_modules":
            (folder / "node_modules").symlink_to(packages)
        (folder / "spark.html").write_text(PAGE)
        with served(folder) as address, chromium(folder / "profile") as browser:
            for name in arguments.scenes:
                read = st.read(SCENES[name])
                leaves = read.gaussians.take(read.tree.is_leaf).with_sh_degree(0)
                flat = st.Scene.flat(leaves, mode=read.mode)
                st.write(flat, folder / "leaves.ply", force=True)
                page = browser.new_page()
                page.open(address + "spark.html")
                page.wait_for("window.isReady")
                levels = {method: spark_tree(page, quality) for method, quality in METHODS.items()}
                page.close()
                for row in compared(name, flat, levels, arguments.shares):
                    rows.append(row)
                    print(row, flush=True)
    print(table(rows))
    about = "Cuts of our levels against what Spark 2.2 draws of its own levels, at equal visible nodes; scenes without harmonics."
    save("levels_spark", rows, about=about)


if __name__ == "__main__":
    main()
