"""The laws of culling: an exact rule changes no bit of any picture, whatever the scene, and the paper's own rule does."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.clusters.cull import cull, runs_of
from splatree.clusters.survivors import survivors
from splatree.kernels.reference.select import in_runs
from splatree.scene.options import Cull
from splatree.scene.view import view_of

from ..kernels.conftest import SCENES
from ..scenes import gaussians
from .conftest import balls

RULES: tuple[Cull, ...] = ("exact", "exact-inria", "exact-gsplat")


def views(n: int, seed: int) -> list[st.Camera]:
    """Cameras in and around a cloud of radius 3: fields of view of 20 to 120°, principal points off the centre."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(n):
        eye, target = rng.normal(size=(2, 3)) * 2
        view = st.Camera.look_at(eye, target, width=67, height=45, fov_y_deg=rng.uniform(20, 120))
        K = view.K.copy()
        K[:2, 2] += rng.uniform(-20, 20, 2)
        found.append(st.Camera(view.camera_from_world, K, 67, 45))
    return found


def same_picture(one: st.Frame, other: st.Frame) -> bool:
    return all(
        getattr(one.result, name).tobytes() == getattr(other.result, name).tobytes()
        for name in ("image", "alpha", "depth")
    )


NO_CULL = st.SelectOptions(cull="none")


@pytest.mark.parametrize("clusters", [1, 9, 300])
def test_exact_culling_changes_neither_selection_nor_picture(clusters: int) -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(300, 1, log_scales=(-6, 0), spread=3.0)), clusters)
    dropped = 0
    for camera in views(12, 2):
        whole, culled = st.trace(scene, camera, select=NO_CULL), st.trace(scene, camera)
        assert culled.culling is not None and culled.culling.rule == "exact"
        np.testing.assert_array_equal(whole.selection.rows, culled.selection.rows)
        assert same_picture(whole, culled)
        dropped += len(scene) - culled.culling.num_rows
    assert dropped >= {1: 0, 9: 0, 300: 1000}[clusters]  # else nothing was tried


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_hard_scenes_keep_every_bit(name: str, mode: str) -> None:
    g, camera = SCENES[name]()
    if len(g) == 0:
        pytest.skip("nothing to put into clusters")
    scene = st.build_clusters(st.Scene.flat(g, mode=mode), max(1, len(g) // 3))  # type: ignore[arg-type]
    options = st.RenderOptions(background=(0.2, 0.5, 0.9))
    assert same_picture(st.trace(scene, camera, options, NO_CULL), st.trace(scene, camera, options))


@pytest.mark.parametrize(
    "select",
    [
        {"pixel_error": 0.0},
        {"pixel_error": 20.0},
        {"pixel_error": np.inf},
        {"profile": "sphere", "pixel_error": 20.0},
        {"rule": "paper-strict"},
        {"rule": "release", "profile": "ref"},
        {"rule": "log-serial"},
        {"budget": 150},
    ],
    ids=str,
)
def test_culling_composes_with_the_cut(select: dict[str, object]) -> None:
    tree = st.build_clusters(st.build_lod(st.Scene.flat(gaussians(500, 3, log_scales=(-6, -3), spread=3.0))), 250)
    dropped = 0
    for camera in views(6, 4):
        one = st.trace(tree, camera, select=st.SelectOptions(cull="none", **select))  # type: ignore[arg-type]
        other = st.trace(tree, camera, select=st.SelectOptions(cull="exact", **select))  # type: ignore[arg-type]
        np.testing.assert_array_equal(one.selection.rows, other.selection.rows)
        assert same_picture(one, other)
        dropped += len(tree) - other.culling.num_rows  # type: ignore[union-attr]
    assert dropped > len(tree) / 2


@pytest.mark.parametrize("threshold", [1e-4, 1 / 255, 0.2])
@pytest.mark.parametrize("dilation", [0.0, 0.3, 50.0])
def test_other_thresholds_and_dilations_keep_every_bit(threshold: float, dilation: float) -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(300, 5, log_scales=(-6, -1), spread=3.0)), 100)
    options = st.RenderOptions(threshold=threshold, dilation_px2=dilation)
    for camera in views(6, 6):
        assert same_picture(st.trace(scene, camera, options, NO_CULL), st.trace(scene, camera, options))


@pytest.mark.parametrize("tile_rule", ["3sigma", "tau", "balanced"])
@pytest.mark.parametrize("threshold", [1 / 255, 0.3])
def test_other_tile_rules_keep_every_bit(tile_rule: str, threshold: float) -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(300, 5, log_scales=(-6, -1), spread=3.0)), 100)
    options = st.RenderOptions(threshold=threshold, tile_rule=tile_rule)  # type: ignore[arg-type]
    dropped = 0
    for camera in views(8, 6):
        one, other = st.trace(scene, camera, options, NO_CULL), st.trace(scene, camera, options)
        assert same_picture(one, other)
        np.testing.assert_array_equal(one.splats.rows, other.splats.rows)
        dropped += len(scene) - other.culling.num_rows  # type: ignore[union-attr]
    assert dropped > 300


def test_a_tree_is_culled_by_its_blocks_unless_clusters_are_asked_for() -> None:
    tree = st.build_clusters(st.build_lod(st.Scene.flat(gaussians(2000, 3))), 40)
    camera = views(1, 4)[0]
    assert st.trace(tree, camera).culling is None
    assert st.trace(tree, camera, select=st.SelectOptions(cull="exact")).culling is not None


def around(camera: st.Camera, n: int, seed: int) -> st.Gaussians:
    """Gaussians of all sizes and shapes at all distances from the eye, from a hundredth to ten thousand."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = camera.position + directions * 10.0 ** rng.uniform(-2, 4, (n, 1))
    largest = rng.uniform(np.log(1e-4), np.log(1e2), (n, 1))
    log_scales = largest - rng.uniform(0, np.log(100), (n, 3))
    logits = rng.normal(0, 3, n)
    quats = rng.normal(size=(n, 4))
    columns = (x.astype(np.float32) for x in (means, quats, log_scales, logits, np.zeros((n, 1, 3))))
    return st.Gaussians(*columns)


def lost_by(rule: Cull, rasteriser: Cull, seeds: range) -> tuple[int, int, int]:
    """Survivors that the rule leaves out; rows that it leaves out; rows that do not survive."""
    lost = excluded = unseen = 0
    for seed, camera in zip(seeds, itertools.cycle(views(20, 7))):  # views come again and again
        scene = st.build_clusters(st.Scene.flat(around(camera, 400, seed)), (400, 60, 8)[seed % 3])
        seen = survivors(scene.gaussians, view_of(scene, camera), rasteriser)
        kept = np.zeros(len(scene), bool)
        kept[cull(scene.clusters, camera, rule).rows] = True  # type: ignore[arg-type]
        lost += int((seen & ~kept).sum())
        excluded += int((~kept).sum())
        unseen += int((~seen).sum())
    return lost, excluded, unseen


@pytest.mark.parametrize("rule", RULES)
def test_no_survivor_of_its_rasteriser_is_lost(rule: Cull) -> None:
    # The command `splatree bench cullfuzz` does the same for millions.
    lost, excluded, unseen = lost_by(rule, rule, range(12))
    assert lost == 0
    assert excluded > 0.25 * unseen


@pytest.mark.parametrize("rule", ["paper", "paper-guard", "paper-distance"])
def test_the_rule_of_the_paper_does_lose_survivors(rule: Cull) -> None:
    assert lost_by(rule, "exact-inria", range(12))[0] > 0


def test_survivors_of_the_published_rasterisers_are_those_of_our_squares_and_hold_those_of_our_ellipses() -> None:
    squares, ellipses = st.RenderOptions(tile_rule="3sigma", threshold=1e-30), st.RenderOptions()
    counts = {"squares": 0, "differ": 0, "ellipses": 0}
    for seed in range(6):
        view = views(6, 20)[seed]
        K = np.array(
            [[view.K[0, 0], 0, 33.5], [0, view.K[1, 1], 22.5], [0, 0, 1]]
        )  # their slopes are held about the middle
        camera = st.Camera(view.camera_from_world, K, 67, 45)
        scene = st.Scene.flat(gaussians(300, seed, log_scales=(-6, 0), spread=3.0))
        drawn = {}
        for name, options in (("squares", squares), ("ellipses", ellipses)):
            drawn[name] = np.zeros(len(scene), bool)
            select = st.SelectOptions(view_test="none", pixel_error=0)
            drawn[name][st.trace(scene, camera, options, select).splats.rows] = True
        inria, gsplat = (
            survivors(scene.gaussians, view_of(scene, camera, ellipses), rule)
            for rule in ("exact-inria", "exact-gsplat")
        )
        counts["squares"] += int(drawn["squares"].sum())
        counts["differ"] += int((inria != drawn["squares"]).sum())
        counts["ellipses"] += int(drawn["ellipses"].sum())
        assert not (drawn["ellipses"] & ~gsplat).any()
    assert counts["squares"] > 300 and counts["ellipses"] > 200
    assert counts["differ"] <= 3


def test_survivors_of_every_rasteriser_hold_what_is_plainly_in_view() -> None:
    scene = st.Scene.flat(gaussians(300, 8))
    camera = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=64, height=48)
    points = scene.gaussians.means @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    pixels = points[:, :2] / points[:, 2:] * camera.K[0, 0] + camera.K[:2, 2]
    inside = ((pixels > 1) & (pixels < (63, 47))).all(axis=1)
    opaque = scene.gaussians.logit_opacities > -5
    for rule in RULES:
        seen = survivors(scene.gaussians, view_of(scene, camera), rule)
        assert seen[inside & opaque].all()
        assert not seen.all()
    behind = st.Camera.look_at((0, 0, -20), (0, 0, -40), width=64, height=48)
    assert not any(survivors(scene.gaussians, view_of(scene, behind), rule).any() for rule in RULES)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [1, -1])
def test_planes_meet_a_sphere_where_geometry_says(axis: int, side: int) -> None:
    # f = 50 px and 100 px across: the right border is the plane x = z, at distance (x − z) / √2; and so the others.
    K = np.array([[50.0, 0, 50], [0, 50, 50], [0, 0, 1]])
    camera = st.Camera(np.eye(4), K, 100, 100)
    for distance, seen in ((0.99, True), (1.01, False)):
        center = np.zeros((1, 3), np.float32)
        center[0, axis], center[0, 2] = side * (5 + distance / np.sqrt(2)), 5 - distance / np.sqrt(2)
        index = balls(np.int32([0, 1]), center)
        assert cull(index, camera, "planes").kept[0] == seen
        # Eq. 3 leaves out what is farther than f R / Z px from the border: here x − z > 1, at a distance of 0.71.
        assert cull(index, camera, "paper").kept[0] == (distance < np.sqrt(0.5))


@pytest.mark.parametrize(("rule", "slack_px"), [("exact", 0.1), ("exact-inria", 2.4), ("exact-gsplat", 1.2)])
@pytest.mark.parametrize("size", [(64, 48), (60, 41)])
def test_margins_of_a_rasteriser_are_as_wide_as_they_must_be(
    rule: Cull, slack_px: float, size: tuple[int, int]
) -> None:
    """Opaque points, each a cluster, across each border: what is kept ends where survivors end, within what is rounded up."""
    camera = st.Camera(np.eye(4), np.array([[80.0, 0, 27], [0, 90, 25], [0, 0, 1]]), *size)
    steps = np.arange(-30, 30, 0.05)
    scene = st.Scene.flat(gaussians(len(steps), 0, degree=0))
    g = scene.gaussians
    g.log_scales[:], g.logit_opacities[:] = -12, 8
    for axis, (focal, centre) in enumerate(((80.0, 27.0), (90.0, 25.0))):
        for border in (0, size[axis]):
            g.means[:] = (0, 0, 5)
            g.means[:, axis] = (border + steps - centre) / focal * 5
            one_each = st.build_clusters(scene, len(steps))
            seen = survivors(one_each.gaussians, view_of(one_each, camera), rule)
            kept = cull(one_each.clusters, camera, rule).kept  # type: ignore[arg-type]
            at = one_each.gaussians.means[:, axis] * focal / 5 + centre - border
            if border == 0:
                at = -at
            assert not (seen & ~kept).any()
            assert at[seen].max() <= at[kept].max() <= at[seen].max() + slack_px


def beams(n: int, seed: int, camera: st.Camera) -> st.Gaussians:
    """Gaussians 100,000 times as long as thick, about parallel to a border of the view, on either side of it."""
    rng = np.random.default_rng(seed)
    g = gaussians(n, seed, degree=0)
    (fx, _, cx), (_, fy, cy), _ = camera.K
    borders = np.array([-cx, camera.width - cx, -cy, camera.height - cy]) / (fx, fx, fy, fy)  # slopes
    border, depth = rng.integers(0, 4, n), 10.0 ** rng.uniform(-0.5, 3, n)
    across = border // 2
    along, means = np.zeros((2, n, 3))
    rows = np.arange(n)
    # Directions in the plane through the eye and the border, and slopes a little off it.
    along[rows, 1 - across], along[:, 2] = rng.normal(size=n), rng.normal(size=n)
    along[rows, across] = borders[border] * along[:, 2]
    means[rows, across] = (borders[border] + rng.normal(0, 0.05, n)) * depth
    means[rows, 1 - across], means[:, 2] = rng.normal(0, 1, n) * depth, depth
    along += rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-7, -2, (n, 1))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    R, eye = camera.camera_from_world[:3, :3], camera.position
    turned = along @ R  # the quaternion (1 + x, 0, −z, y) turns the x axis to (x, y, z)
    quats = np.stack([1 + turned[:, 0], np.zeros(n), -turned[:, 2], turned[:, 1]], axis=1)
    lengths = np.log(depth * 10.0 ** rng.uniform(-1, 2, n))
    log_scales = np.stack([lengths, lengths - np.log(1e5), lengths - np.log(1e5)], axis=1)
    return st.Gaussians(
        *((x.astype(np.float32)) for x in (means @ R + eye, quats, log_scales)), g.logit_opacities + 3, g.sh
    )


def test_beams_along_a_border_are_kept_where_they_are_drawn_and_left_out_where_a_sphere_would_not_be() -> None:
    drawn = by_boxes = by_spheres = 0
    for seed, camera in enumerate(views(20, 30)):
        scene = st.build_clusters(st.Scene.flat(beams(500, seed, camera)), 500)
        assert scene.clusters is not None
        seen = survivors(scene.gaussians, view_of(scene, camera), "exact")
        kept = np.zeros(len(scene), bool)
        kept[cull(scene.clusters, camera).rows] = True
        assert not (seen & ~kept).any()
        everything = np.full_like(scene.clusters.centers, np.inf)
        spheres = replace(scene.clusters, box_low=-everything, box_high=everything)
        drawn += int(seen.sum())
        by_boxes += len(scene) - int(kept.sum())
        by_spheres += len(scene) - cull(spheres, camera).num_rows
    assert drawn > 1000
    assert by_boxes > 1.5 * by_spheres


def test_behind_the_eye_the_rules_differ_as_they_say() -> None:
    camera = st.Camera(np.eye(4), np.array([[50.0, 0, 50], [0, 50, 50], [0, 0, 1]]), 100, 100)
    index = balls(np.int32([0, 1]), np.float32([[0, 0, -0.5]]))  # a unit ball that reaches half a unit before the eye
    kept = {rule: bool(cull(index, camera, rule).kept[0]) for rule in (*RULES, "planes", "paper", "paper-guard")}
    assert kept == dict.fromkeys((*RULES, "planes", "paper-guard"), True) | {"paper": False}


def test_runs_join_neighbours() -> None:
    start = np.int32([0, 3, 5, 9, 10, 14])
    assert runs_of(start, np.array([1, 1, 0, 1, 1], bool)).tolist() == [[0, 5], [9, 14]]
    assert runs_of(start, np.zeros(5, bool)).tolist() == []
    culling = st.Culling(np.array([1, 0, 1, 1, 0], bool), runs_of(start, np.array([1, 0, 1, 1, 0], bool)), "exact")
    assert culling.rows.tolist() == [0, 1, 2, 5, 6, 7, 8, 9]
    assert culling.num_rows == 8
    assert np.flatnonzero(in_runs(np.arange(16, dtype=np.int32), culling.runs)).tolist() == culling.rows.tolist()


def test_select_draws_no_row_of_an_excluded_cluster() -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(3000, 9, spread=3.0)), 100)
    camera = views(1, 10)[0]
    options = st.SelectOptions(view_test="none", pixel_error=0)
    for drop in (2, 3, 7):
        kept = np.arange(100) % drop != 0
        culling = st.Culling(kept, runs_of(scene.clusters.start, kept), "exact")  # type: ignore[union-attr]
        rows = st.select(scene, camera, options, culling=culling).rows
        np.testing.assert_array_equal(rows, culling.rows)


def test_a_rule_without_clusters_is_an_error() -> None:
    scene = st.Scene.flat(gaussians(10, 11))
    camera = views(1, 12)[0]
    with pytest.raises(st.InputError, match="found rule 'paper' for a scene without clusters"):
        st.render(scene, camera, select=st.SelectOptions(cull="paper"))
    with pytest.raises(st.InputError, match="cull: found 'half', wanted 'none', 'exact'"):
        st.SelectOptions(cull="half")  # type: ignore[arg-type]
    st.render(scene, camera, select=st.SelectOptions(cull="none"))
