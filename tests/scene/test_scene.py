from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError, ShapeError
from splatree.lod.blocks import with_blocks

from ..scenes import gaussians


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("mode", "mip", "Scene.mode: found 'mip', wanted 'classic' or 'antialiased'"),
        ("tile_rule", "box", "Scene.tile_rule: found 'box', wanted 'ellipse'"),
        ("threshold", 0.0, "Scene.threshold: found 0.0"),
        ("threshold", 1.0, "Scene.threshold: found 1.0"),
        ("threshold", float("nan"), "Scene.threshold: found nan"),
    ],
)
def test_what_no_scene_can_be_is_refused(field, value, message):
    scene = st.Scene.flat(gaussians(3, 0))
    with pytest.raises(InputError, match=message):
        replace(scene, **{field: value})


def test_a_scene_is_printed_by_the_shapes_of_its_columns():
    scene = st.Scene.flat(gaussians(3000, 1))
    text = repr(scene)
    assert "means=float32(3000, 3)" in text and "sh=float32(3000, 4, 3)" in text and "mode='classic'" in text
    thinned, camera = st.thin(scene), st.orbit(scene, st.PathOptions(width=64, height=36))[0]
    assert max(len(text), len(repr(thinned)), len(repr(st.render(scene, camera)))) < 1500


def test_columns_of_other_gaussians_are_refused():
    scene = with_blocks(st.build_clusters(st.Scene.flat(gaussians(300, 1)), 5))
    other = st.Scene.flat(gaussians(300, 2))
    with pytest.raises(ShapeError, match=r"Scene\.tree: found 300 rows, wanted 3"):
        replace(scene, gaussians=gaussians(3, 1))
    with pytest.raises(ShapeError, match=r"Scene\.blocks: found the index of other Gaussians"):
        replace(scene, gaussians=other.gaussians, clusters=None)
    with pytest.raises(ShapeError, match=r"Scene\.clusters: found the clusters of other Gaussians"):
        replace(scene, gaussians=other.gaussians, blocks=None)
    with pytest.raises(ShapeError, match="ids"):
        replace(scene, ids=np.arange(299, dtype=np.uint32))


def test_clusters_fit_only_if_each_sphere_and_box_holds_its_first_row():
    scene = st.build_clusters(st.Scene.flat(gaussians(300, 1)), 5)
    clusters = scene.clusters
    assert clusters.fits(scene.gaussians)
    assert not clusters.fits(gaussians(299, 1))
    for name in ("mean_radii", "radii", "footprint_radii"):
        smaller = getattr(clusters, name).copy()
        first = scene.gaussians.take(clusters.start[:1])
        away = np.linalg.norm(first.means[0] - clusters.centers[0])
        smaller[0] = 0.99 * away  # less than what any of the radii must hold, as σ > 0
        assert not replace(clusters, **{name: smaller}).fits(scene.gaussians)
    row = int(np.argmax(scene.gaussians.logit_opacities[clusters.start[:-1]]))  # a first row that is drawn
    mean = scene.gaussians.means[clusters.start[row]]
    for name in ("box_low", "box_high"):
        smaller = getattr(clusters, name).copy()
        smaller[row, 1] = mean[1]
        assert not replace(clusters, **{name: smaller}).fits(scene.gaussians)


def test_extents_of_a_flat_scene_hold_three_standard_deviations():
    g = gaussians(500, 3, log_scales=(-12, 80))
    extents = st.Scene.flat(g).tree.extents.astype(np.float64)
    wanted = 3 * np.exp(g.log_scales.max(axis=1).astype(np.float64))
    assert (extents >= wanted).all()
    # The margin of 2⁻²⁰, and what float32's exponential is off at 80, 80 × 2⁻²⁴.
    np.testing.assert_allclose(extents, wanted, rtol=1e-5)


@pytest.mark.parametrize(
    "use",
    [
        lambda scene: st.render(scene, st.Camera.look_at([0, 0, -5], [0, 0, 0], width=8, height=8)),
        lambda scene: st.write(scene, "never.ply"),
        st.build_lod,
        lambda scene: st.thin(scene, st.ThinOptions(keep=0.5)),
    ],
)
def test_what_is_no_scene_is_told_with_the_way_to_one(use):
    with pytest.raises(InputError, match=r"found Gaussians, wanted a Scene; make one with Scene\.flat"):
        use(st.Gaussians.empty())
    with pytest.raises(InputError, match=r"found str, wanted a Scene; read one with splatree\.read"):
        use("city.ply")
