"""Streams in the viewers that they are made for: PlayCanvas, Spark and Cesium from npm, in Chromium, by the pages of `serve`.

The picture of the viewer is compared with the library's picture of what the viewer's rule chooses, as `splatree.stream.readers`
repeats it. Viewers cut splats off earlier than we do and sort by other keys.
"""

import dataclasses
import json
import zipfile
from urllib.parse import urlencode

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.rad.container import open_rad
from splatree.stream.rad import as_written
from splatree.stream.readers.cesium import open_tileset, select_cesium
from splatree.stream.readers.playcanvas import select_by_errors, select_playcanvas
from splatree.stream.readers.playcanvas_drawing import ENGINE_DILATION_PX2, draw_playcanvas
from splatree.stream.readers.sog_stream import open_sog_stream
from splatree.stream.readers.spark import select_spark

from .chromium import find_chromium
from .peers import install

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="tests in a browser need Chromium, which is not installed"),
]

SIZE = (384, 216)
BUDGET = 60_000
EVERY_ROW = st.SelectOptions(pixel_error=0)


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    found, reason = install(tmp_path_factory.mktemp("npm"))
    if found is None:
        pytest.skip(reason)
    return found


@pytest.fixture(scope="module")
def tree(city_tree):
    """The city without its far surroundings' harmonics, which the software GPU is slow with."""
    return st.Scene(city_tree.gaussians.with_sh_degree(0), city_tree.tree)


@pytest.fixture(scope="module")
def served(tree, packages, tmp_path_factory):
    folder = tmp_path_factory.mktemp("streams")
    st.stream(tree, folder / "city")
    st.stream(tree, folder / "city.rad", "rad")
    st.stream(tree, folder / "chunked.rad", "rad", st.StreamOptions(chunked=True))
    st.stream(tree, folder / "tiles", "3dtiles", st.StreamOptions(tile_nodes=16_000))
    with st.serve(folder, st.ServeOptions(port=0, packages=str(packages))) as server:
        yield server


@pytest.fixture(scope="module")
def camera(tree):
    """A view from over the roofs, in which most Gaussians are larger than a pixel."""
    centre = np.median(tree.gaussians.means, axis=0)
    radius = float(np.quantile(np.linalg.norm(tree.gaussians.means - centre, axis=1), 0.9))
    eye = centre + radius * np.array([0.3, -0.5, -0.8])
    return st.Camera.look_at(eye, centre, width=SIZE[0], height=SIZE[1])


def shown(browser, server, viewer, stream, camera, until="window.splatree?.ready", **options):
    """The picture of a viewer, what its page says, and the size of each file that it loaded."""
    forward = camera.camera_from_world[2, :3]
    fov = 2 * np.degrees(np.arctan(0.5 * camera.height / camera.K[1, 1]))

    query = {
        "stream": stream,
        "pos": listed(camera.position),
        "target": listed(camera.position + 10 * forward),
        "up": listed(-camera.camera_from_world[1, :3]),
        "fov": fov,
    }
    page = browser.new_page()
    page.open(f"{server.address}open/{viewer}?{urlencode(query | options)}", size=SIZE)
    page.wait_for(f"{until} || window.splatree?.error", timeout=240)
    said = json.loads(page.evaluate("JSON.stringify(window.splatree)"))
    page.evaluate("window.splatree.stop()")  # a software GPU cannot draw and be photographed at once
    picture = page.screenshot()
    entries = page.evaluate("performance.getEntriesByType('resource').map((e) => [e.name, e.encodedBodySize])")
    loaded = [(name, size) for name, size in entries if "/packages/" not in name and "/page/" not in name]
    assert page.errors == [] and "error" not in said
    return picture, said, loaded


def as_drawn(select, stream, camera, count):
    """The levels of our rule that have as many rows as the engine drew, which has to be one of the choices of the rule.

    What the files leave empty is taken from the budget, and how much that is may depend on the order in which they came. Without
    files, a budget of exactly the rows of a choice leads to this choice, and any other number does not lead to itself.
    """
    ours = select(stream.ranges, camera, BUDGET)
    assert count <= BUDGET and abs(count / len(stream.gaussians_of(ours)) - 1) <= 0.03  # a chunk's level or two
    without_files = dataclasses.replace(stream.ranges, files=np.full_like(stream.ranges.files, -1))
    levels = select(without_files, camera, count)
    assert len(stream.gaussians_of(levels)) == count
    return levels


def listed(vector):
    return ",".join(f"{x:.9g}" for x in vector)


def drawn(gaussians, camera):
    return np.clip(st.render(st.Scene.flat(gaussians), camera, select=EVERY_ROW).image, 0, 1)


def psnr(picture, truth):
    return st.psnr(picture.astype(np.float32), np.asarray(truth, np.float32))


@pytest.mark.parametrize("dilation", [ENGINE_DILATION_PX2, 0.3])
def test_playcanvas_draws_the_levels_of_our_streamed_sog(browser, served, tree, camera, dilation):
    """Both as the engine comes and as the page sets it: pictures are at 40 dB and more against ours of how it draws."""
    stream = open_sog_stream(served.folder / "city")
    picture, said, loaded = shown(
        browser, served, "playcanvas", "city/lod-meta.json", camera, budget=BUDGET, dilation=dilation
    )
    levels = as_drawn(select_playcanvas, stream, camera, said["drawn"])
    chosen = stream.gaussians_of(levels)
    expected = np.clip(draw_playcanvas(chosen, camera, dilation_px2=dilation).image, 0, 1)
    assert psnr(picture, expected) >= 38
    assert abs(picture.mean() / expected.mean() - 1) <= 0.01
    whole = drawn(tree.gaussians.take(tree.tree.is_leaf), camera)
    assert abs(psnr(picture, whole) - psnr(expected, whole)) <= 0.5
    # What the page sets brings the picture to the library's of the same nodes: as the engine comes it loses 2.4 dB.
    loss = psnr(drawn(chosen, camera), whole) - psnr(picture, whole)
    assert loss <= 0.6 if dilation == 0.3 else loss >= 1.5
    # The units that are chosen, those of the coarsest level, which come first, and the manifest.
    coarsest = np.full(len(levels), len(stream.ranges.counts) - 1)
    units = np.union1d(stream.files_of(levels), stream.files_of(coarsest))
    wanted = stream.file_bytes[units].sum() + (stream.folder / "lod-meta.json").stat().st_size
    assert sum(size for _, size in loaded) <= 1.05 * wanted


def test_playcanvas_with_a_tenth_is_as_bright_as_the_whole(browser, served, tree, camera):
    whole = drawn(tree.gaussians.take(tree.tree.is_leaf), camera)
    quality, brightness = [], []
    for budget in (tree.tree.num_leaves // 10, tree.tree.num_leaves):
        picture, _, _ = shown(browser, served, "playcanvas", "city/lod-meta.json", camera, budget=budget)
        quality.append(psnr(picture, whole))
        brightness.append(picture.mean())
    assert quality[1] >= 33, quality  # all leaves: what the engine's rims and its steps of scales and opacities cost
    assert abs(brightness[0] / brightness[1] - 1) <= 0.1, brightness


def test_playcanvas_of_before_draws_a_stream_with_errors_out_of_a_zip(browser, tree, camera, tmp_path):
    """Version 2.22 is the last that reads errors. The stream comes out of a zipped one, as it is."""
    older, reason = install(tmp_path, {"playcanvas": "2.22.6"})
    if older is None:
        pytest.skip(reason)
    st.stream(tree, tmp_path / "city.ssog", options=st.StreamOptions(errors=True, zip=True, levels=4))
    with zipfile.ZipFile(tmp_path / "city.ssog") as archive:
        archive.extractall(tmp_path / "served" / "city")
    stream = open_sog_stream(tmp_path / "served" / "city")
    by_errors, by_distance = (select(stream.ranges, camera, BUDGET) for select in (select_by_errors, select_playcanvas))
    assert not np.array_equal(by_errors, by_distance)
    with st.serve(tmp_path / "served", st.ServeOptions(port=0, packages=str(older))) as server:
        picture, said, _ = shown(
            browser, server, "playcanvas", "city/lod-meta.json", camera, budget=BUDGET, lod="error"
        )
    chosen = stream.gaussians_of(as_drawn(select_by_errors, stream, camera, said["drawn"]))
    assert psnr(picture, draw_playcanvas(chosen, camera, dilation_px2=0.3).image) >= 35


def test_spark_draws_our_rad_chunk_by_chunk(browser, served, tree, camera):
    nodes = as_written(tree, st.StreamOptions())
    view = select_spark(nodes, camera, BUDGET)
    settled = "window.splatree?.quietMs > 15_000"  # on a software GPU a sort takes seconds
    picture, said, loaded = shown(browser, served, "spark", "city.rad", camera, settled, budget=BUDGET)
    assert abs(said["chosen"] / len(view.drawn) - 1) <= 0.01
    assert psnr(picture, drawn(nodes.gaussians.take(view.drawn), camera)) >= 28
    assert {name.rsplit("/", 1)[1] for name, _ in loaded} == {"city.rad"}


def test_spark_loads_chunks_that_are_files_of_their_own(browser, served, tree, camera):
    nodes = as_written(tree, st.StreamOptions())
    view = select_spark(nodes, camera, BUDGET)
    settled = "window.splatree?.quietMs > 15_000"
    picture, said, loaded = shown(browser, served, "spark", "chunked.rad", camera, settled, budget=BUDGET)
    assert abs(said["chosen"] / len(view.drawn) - 1) <= 0.01
    assert psnr(picture, drawn(nodes.gaussians.take(view.drawn), camera)) >= 28
    chunks = {chunk.path.name for chunk in open_rad(served.folder / "chunked.rad").chunks}
    names = {name.rsplit("/", 1)[1] for name, _ in loaded}
    assert "chunked.rad" in names and names - {"chunked.rad"} and names - {"chunked.rad"} <= chunks


def test_cesium_draws_our_tiles(browser, served, tree, camera):
    """Seen from one side, so that a scene turned about its up axis would be found out."""
    tiles = open_tileset(served.folder / "tiles")
    chosen = select_cesium(tiles, camera, most_px=100)  # fewer, for the software GPU
    gaussians = st.Gaussians.concatenate(
        [st.read(served.folder / "tiles" / tiles.names[tile]).gaussians for tile in chosen.drawn]
    )
    picture, said, loaded = shown(browser, served, "cesium", "tiles/tileset.json", camera, sse=100)
    assert said["drawn"] == len(gaussians)
    expected = drawn(gaussians, camera)  # Cesium widens small splats less: 19.7 dB
    assert psnr(picture, expected) >= max(18, psnr(picture, expected[:, ::-1]) + 3)
    names = {name.rsplit("/", 1)[1] for name, _ in loaded}
    assert names == {"tileset.json", *(tiles.names[tile] for tile in chosen.loaded)}
