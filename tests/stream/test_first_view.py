"""The first view of a stream, found from its coarsest piece."""

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.rad.reader import read_first_chunk
from splatree.lod.build import leaves_of
from splatree.stream.first_view import first_view

from .conftest import forest


@pytest.fixture(scope="module")
def quarter_of_city(city_tree):
    """A quarter of the city's leaves, and levels over them: more than a chunk of a .rad holds."""
    leaves = leaves_of(city_tree)
    flat = st.Scene.flat(leaves.gaussians.take(np.arange(0, len(leaves), 4)), mode=leaves.mode, source=leaves.source)
    return st.build_lod(flat, st.BuildOptions("radius"))


@pytest.mark.parametrize(
    ("format", "name", "inside", "options"),
    [
        ("sog", "out", "lod-meta.json", None),
        ("rad", "out.rad", "", None),
        ("rad", "out.rad", "", st.StreamOptions(chunked=True)),
        ("3dtiles", "out", "tileset.json", st.StreamOptions(tile_nodes=8000)),
    ],
)
def test_it_holds_the_scene(quarter_of_city, tmp_path, format, name, inside, options):
    """Nine leaves of ten of the city's middle are in the picture, as they are in the library's own first view (97 %)."""
    written = st.stream(quarter_of_city, tmp_path / name, format, options)
    framing, mode = first_view(written.output / inside if inside else written.output)
    assert mode == quarter_of_city.mode and framing.up[1] < -0.9 and not framing.inside
    camera = framing.camera()
    means = quarter_of_city.gaussians.means[quarter_of_city.tree.is_leaf]
    means = means[np.linalg.norm(means - framing.centre, axis=1) < framing.radius]
    x, y, z = (means @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]).T
    is_in = (z > 0) & (np.abs(x) * camera.K[0, 0] < 480 * z) & (np.abs(y) * camera.K[1, 1] < 270 * z)
    assert is_in.mean() > 0.9


def test_the_first_chunk_of_a_rad_stands_for_the_scene_once(city_tree, tmp_path):
    """No node of it lies above another one: of 65,536 nodes those whose children are elsewhere, or who have none."""
    st.stream(city_tree, tmp_path / "a.rad", "rad", st.StreamOptions(sh_degree=0))
    found = read_first_chunk(tmp_path / "a.rad")
    assert 20_000 < len(found) < 65_536
    back = st.read(tmp_path / "a.rad")
    rows = {mean.tobytes(): row for row, mean in enumerate(back.gaussians.means)}
    chosen = np.zeros(len(back) + 1, np.int64)
    for mean in found.gaussians.means:
        row = rows[mean.tobytes()]
        chosen[row] += 1
        chosen[back.tree.subtree_end[row]] -= 1
    covered = np.cumsum(chosen)[:-1]
    assert covered.max() == 1
    assert covered[back.tree.is_leaf].mean() > 0.999  # one family may lie in two chunks


def test_a_scene_without_levels_is_its_own_first_chunk(tmp_path):
    flat = st.Scene.flat(forest(300, seed=2).gaussians)
    st.write(flat, tmp_path / "a.rad")
    np.testing.assert_array_equal(read_first_chunk(tmp_path / "a.rad").gaussians.means, flat.gaussians.means)
