"""The compiled selection against its definition, and what must not change its result by a bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatree import Camera, Gaussians, GaussianTree, RenderOptions, Scene, SelectOptions, ShapeError, select
from splatree.kernels.cpu.frame.bin import bin as bin_splats
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cpu.frame.project import project
from splatree.kernels.reference import blocks as reference_blocks
from splatree.kernels.reference import select as reference
from splatree.lod.blocks import with_blocks
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.view import view_of

PROFILES = ("exact", "3dgs", "ref", "sphere", "pixel")
VIEW_TESTS = ("footprint", "centre", "none")
seeds = st.integers(0, 2**20)


def random_scene(seed: int) -> Scene:
    """A forest of up to a few thousand rows, levels about half as large as the one above, here and there something hostile."""
    rng = np.random.default_rng(seed)
    parents = random_parents(rng, int(rng.choice([1, 5, 40, 300, 3000])))
    n = len(parents)
    means, log_scales, depth = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, np.uint8)
    means_off, scales_off = rng.normal(size=(n, 3)), rng.normal(0, 0.6, (n, 3))
    for i, p in enumerate(parents):
        if p < 0:
            means[i], log_scales[i] = 4 * means_off[i], scales_off[i]
        else:
            means[i] = means[p] + np.exp(log_scales[p].mean()) * means_off[i]
            log_scales[i] = 0.7 * log_scales[p] - 0.8 + scales_off[i]
            depth[i] = depth[p] + 1
    end = np.arange(1, n + 1, dtype=np.int32)
    extents = 3 * np.exp(log_scales.max(axis=1, initial=-np.inf))
    for i in reversed(range(n)):
        if (p := parents[i]) >= 0:
            end[p] = max(end[p], end[i])
            extents[p] = max(extents[p], 1.0001 * (extents[i] + np.linalg.norm(means[i] - means[p])))
    if rng.random() < 0.3:  # levels that were made by pairs: extents say nothing of sizes
        extents *= np.exp(rng.normal(-2, 1, n))
    logits = rng.normal(0, 4, n)
    if rng.random() < 0.5:  # a huge one, a needle, a speck, one that cannot be seen
        hostile = rng.integers(0, n, 4)
        log_scales[hostile] = [[6, 6, 6], [4, -9, -9], [-20, -20, -20], [0, 0, 0]]
        logits[hostile[3]] = -200
    columns = (means, rng.normal(size=(n, 4)), log_scales, logits, np.zeros((n, 1, 3)))
    gaussians = Gaussians(*(column.astype(np.float32) for column in columns))
    return Scene(gaussians, GaussianTree(end, depth, extents.astype(np.float32)))


def random_parents(rng: np.random.Generator, n: int) -> list[int]:
    parents: list[int] = []
    path: list[int] = []
    for i in range(n):
        climb = 0 if rng.random() < 0.4 else 1 + rng.geometric(0.6)
        path = path[: max(0, len(path) - climb)] if len(path) < 9 else path[: int(rng.integers(0, 9))]
        parents.append(path[-1] if path else -1)
        path.append(i)
    return parents


def random_camera(seed: int) -> Camera:
    """From inside to far away, towards the scene or away from it, down to one pixel, with off-centre principal points."""
    rng = np.random.default_rng(seed + 1)
    position = rng.normal(size=3) * rng.choice([0.1, 2.0, 10.0, 100.0])
    target = position + rng.normal(size=3) if rng.random() < 0.2 else rng.normal(size=3)
    width, height = [(320, 200), (96, 64), (1, 1), (33, 500)][rng.integers(0, 4)]
    camera = Camera.look_at(position, target, width=width, height=height, fov_y_deg=rng.choice([15.0, 60.0, 130.0]))
    if rng.random() < 0.3:
        K = camera.K.copy()
        K[0, 0] *= 1.3
        K[:2, 2] += [0.4 * width, -0.2 * height]
        camera = replace(camera, K=K)
    return camera


def random_tau(seed: int) -> float:
    return float(np.random.default_rng(seed + 2).choice([0.0, 1.0, 1.7, 3.0, 8.0, 40.0, 300.0, 1e7, np.inf]))


def visible_within(scene: Scene, camera: Camera, view_test: str, dilation: float, slack: float) -> np.ndarray:
    """The view test with boxes that are ``slack`` px and 0.2 % of it larger."""
    if view_test == "none":
        return np.ones(len(scene), bool)
    splats = reference.project(scene.gaussians, camera)
    size = np.array([camera.width, camera.height])
    logits = scene.gaussians.logit_opacities.astype(np.float64)
    if view_test == "centre":
        reach = 0.05 * size + slack
        bright = np.ones(len(scene), bool)
    else:
        fall = -np.logaddexp(0, -logits) - np.log(scene.threshold)
        variances = np.diagonal(splats.covariances, axis1=1, axis2=2) + dilation
        reach = np.sqrt(2 * np.maximum(fall, 0)[:, None] * variances) * (1 + 0.02 * slack) - 0.5 + slack
        bright = fall >= -0.02 * slack
    inside = ((splats.centres_px + reach >= 0) & (splats.centres_px - reach <= size)).all(axis=1)
    return inside & bright & (splats.depths > camera.near * (1 - 0.001 * np.sign(slack)))


def assert_is_the_cut(rows: np.ndarray, scene: Scene, camera: Camera, options: SelectOptions, dilation: float) -> None:
    """Equal to the definition but for nodes within 1e-4 of τ_R, with what is below them, and boxes within 0.1 px of a border."""
    tree, tau = scene.tree, options.pixel_error
    radii = reference.radii(scene.gaussians, tree.extents, camera, options.resolved_profile, dilation)
    open_nodes = np.zeros(len(scene), bool)
    if np.isfinite(tau) and tau > 0:
        # Float32 has 6e-8, but the larger eigenvalue is a difference of rounded squares; 1e-4 is the band of the laws.
        open_nodes = np.abs(radii / tau - 1) < 1e-4
        # Depths round too: who is beyond the near plane within 0.1 % may be refined or not.
        depths = reference.project(scene.gaussians, camera).depths
        open_nodes |= (np.abs(depths / camera.near - 1) < 1e-3) & (options.resolved_profile not in EXTENT_PROFILES)
    undecided = open_nodes | reference.shadowed(open_nodes, tree.subtree_end)
    cut = np.zeros(len(scene), bool)
    cut[reference.cut_rows(tree, radii, tau)] = True
    chosen = np.zeros(len(scene), bool)
    chosen[rows] = True
    surely, maybe = (visible_within(scene, camera, options.view_test, dilation, slack) for slack in (-0.1, 0.1))
    assert not (cut & surely & ~chosen & ~undecided).any()
    assert not (chosen & ~(cut & maybe) & ~undecided).any()
    assert (np.diff(rows) > 0).all()


@settings(max_examples=30)
@given(
    seed=seeds,
    profile=st.sampled_from(PROFILES),
    view_test=st.sampled_from(VIEW_TESTS),
    dilation=st.sampled_from([0.3, 0.0, 2.0]),
)
def test_kernel_finds_the_defined_cut(seed, profile, view_test, dilation):
    scene, camera = random_scene(seed), random_camera(seed)
    options = SelectOptions(pixel_error=random_tau(seed), profile=profile, view_test=view_test)
    scene = with_blocks(scene, rows_per_block=16)
    rows = select(scene, view_of(scene, camera, RenderOptions(dilation_px2=dilation)), options).rows
    assert_is_the_cut(rows, scene, camera, options, dilation)


@pytest.mark.parametrize("seed", [3, 8, 21])
@pytest.mark.parametrize("profile", PROFILES)
def test_each_instruction_set_finds_the_defined_cut(isa, seed, profile):
    scene, camera = random_scene(seed), random_camera(seed)
    options = SelectOptions(pixel_error=random_tau(seed), profile=profile)
    rows = select(with_blocks(scene, rows_per_block=16), camera, options).rows
    assert_is_the_cut(rows, scene, camera, options, 0.3)


@settings(max_examples=30)
@given(seed=seeds, profile=st.sampled_from(PROFILES), view_test=st.sampled_from(VIEW_TESTS))
def test_threads_and_size_of_blocks_change_nothing(seed, profile, view_test):
    scene, camera = random_scene(seed), random_camera(seed)
    options = SelectOptions(pixel_error=random_tau(seed), profile=profile, view_test=view_test)
    rows = select(scene, camera, options, threads=1).rows.tolist()
    for rows_per_block in (16, 33, 1024):
        split = with_blocks(scene, rows_per_block=rows_per_block)
        for threads in (1, 2, 3):
            assert select(split, camera, options, threads=threads).rows.tolist() == rows


@settings(max_examples=20)
@given(seed=seeds, profile=st.sampled_from(PROFILES))
def test_order_of_roots_and_siblings_changes_nothing(seed, profile):
    scene, camera = random_scene(seed), random_camera(seed)
    options = SelectOptions(pixel_error=random_tau(seed), profile=profile)
    order = shuffled_preorder(scene.tree, np.random.default_rng(seed))
    depth, sizes = scene.tree.depth[order], (scene.tree.subtree_end - np.arange(len(scene)))[order]
    tree = GaussianTree((np.arange(len(scene)) + sizes).astype(np.int32), depth, scene.tree.extents[order])
    moved = Scene(scene.gaussians.take(order), tree)
    there = select(with_blocks(moved, rows_per_block=16), camera, options).rows
    assert sorted(order[there].tolist()) == select(scene, camera, options).rows.tolist()


def shuffled_preorder(tree: GaussianTree, rng: np.random.Generator) -> np.ndarray:
    """Rows in another preorder of the same forest."""
    order: list[int] = []
    stack = [(0, len(tree))]  # runs of siblings with all that is below them
    while stack:
        begin, end = stack.pop()
        if begin < 0:
            order.append(end)
            continue
        siblings = []
        while begin < end:
            siblings.append(begin)
            begin = int(tree.subtree_end[begin])
        for row in rng.permutation(siblings).tolist():
            stack += [(row + 1, int(tree.subtree_end[row])), (-1, row)]
    return np.array(order)


@settings(max_examples=30)
@given(seed=seeds, mode=st.sampled_from(["classic", "antialiased"]), threshold=st.sampled_from([1 / 255, 0.1, 0.9]))
def test_no_row_is_dropped_that_is_listed_in_a_tile(seed, mode, threshold):
    scene, camera = replace(random_scene(seed), mode=mode, threshold=threshold), random_camera(seed)
    view = view_of(scene, camera)
    options = SelectOptions(pixel_error=random_tau(seed))
    scene = with_blocks(scene, rows_per_block=16)
    drawn = select(scene, camera, options).rows
    cut = select(scene, camera, replace(options, view_test="none")).rows
    splats = project(scene.gaussians, None, cut, view)
    listed = splats.rows[np.unique(bin_splats(splats, view).splat_from_pair)]
    assert np.isin(listed, drawn).all()
    assert np.isin(drawn, cut).all()


@settings(max_examples=20)
@given(seed=seeds, rows_per_block=st.sampled_from([16, 50, 1024]), threads=st.integers(1, 3))
def test_block_index_is_as_defined(seed, rows_per_block, threads):
    scene = random_scene(seed)
    fast = index_blocks(scene.gaussians, scene.tree, rows_per_block=rows_per_block, threads=threads)
    slow = reference_blocks.index_blocks(scene.gaussians, scene.tree, rows_per_block=rows_per_block)
    for name in (
        "lower",
        "upper",
        "min_logits",
        "ancestor_start",
        "ancestors",
        "group_lower",
        "group_upper",
        "size_classes",
    ):
        assert np.array_equal(getattr(fast, name), getattr(slow, name)), name
    # Rows that are equally wide but for rounding may be one step or two: what the steps say of any extent is compared.
    for extent in [0.0, *np.unique(scene.tree.extents), np.inf]:
        ours, theirs = (
            np.take_along_axis(made.step_scales, (made.step_extents <= extent).sum(axis=1)[:, None] - 1, axis=1)
            for made in (fast, slow)
        )
        assert np.allclose(ours, theirs, rtol=2e-5)
        assert (ours >= theirs).all()
    for name in ("leaf_scales", "group_leaf_scales"):  # the compiled ones are 1e-5 larger, a reserve for rounding
        ours, theirs = getattr(fast, name), getattr(slow, name)
        assert np.allclose(ours, theirs, rtol=2e-5)
        assert (ours >= theirs).all()


def city(side: int) -> Scene:
    """A grid of side × side roots with four leaves each, along rows of the grid."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    roots = np.stack([x, y, 0 * x], axis=1)
    corners = np.array([[0, 0, 0], [-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]]) / 4
    n = 5 * side * side
    means = (roots[:, None] + corners).reshape(-1, 3).astype(np.float32)
    is_root = np.arange(n) % 5 == 0
    end = np.where(is_root, np.arange(n) + 5, np.arange(n) + 1).astype(np.int32)
    log_scales = np.repeat(np.log(np.where(is_root, 0.3, 0.15))[:, None], 3, axis=1).astype(np.float32)
    quats = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    gaussians = Gaussians(means, quats, log_scales, np.full(n, 3, np.float32), np.zeros((n, 1, 3), np.float32))
    return with_blocks(Scene(gaussians, GaussianTree(end, (~is_root).astype(np.uint8), np.full(n, 2, np.float32))))


def test_an_index_of_other_gaussians_is_refused():
    scene = city(12)
    moved = replace(scene.gaussians, means=scene.gaussians.means + np.float32(1))
    with pytest.raises(ShapeError, match="index of other Gaussians"):
        replace(scene, gaussians=moved)
    with pytest.raises(ShapeError, match="index of other Gaussians"):
        replace(scene, tree=Scene.flat(scene.gaussians).tree)
    assert replace(scene, gaussians=moved, blocks=None).blocks is None


def pairs_of_leaves(roots: np.ndarray, scales: np.ndarray) -> Scene:
    """Round roots at given places with given σ, each above two specks in its middle."""
    n = 3 * len(roots)
    is_root = np.arange(n) % 3 == 0
    means = np.repeat(roots, 3, axis=0).astype(np.float32)
    log_scales = np.where(is_root, np.log(np.repeat(scales, 3)), -12.0)
    quats = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    log_scales = np.repeat(log_scales[:, None], 3, axis=1).astype(np.float32)
    gaussians = Gaussians(means, quats, log_scales, np.full(n, 5, np.float32), np.zeros((n, 1, 3), np.float32))
    end = np.where(is_root, np.arange(n) + 3, np.arange(n) + 1).astype(np.int32)
    tree = GaussianTree(end, (~is_root).astype(np.uint8), np.full(n, 9, np.float32))
    return with_blocks(Scene(gaussians, tree), rows_per_block=16)


@pytest.mark.parametrize("profile", ["exact", "3dgs", "ref"])
def test_nodes_just_below_the_limit_are_not_passed_over_by_their_size_class(profile):
    # Round splats in the middle of the view have the least radius that their size class allows.
    sizes = 0.02 * 2 ** np.linspace(-1, 1, 400)
    scene = pairs_of_leaves(np.zeros((400, 3)), sizes)
    camera = Camera.look_at(np.array([0.0, 0.0, -5.0]), np.zeros(3), width=640, height=640)
    radius = reference.radii(scene.gaussians, scene.tree.extents, camera, profile, 0.3)[::3]
    for limit in radius[150:250:7]:
        rows = select(scene, camera, SelectOptions(pixel_error=1.001 * limit, profile=profile)).rows
        assert np.isin(np.flatnonzero(radius <= limit) * 3, rows).all()


def test_a_small_node_is_not_lost_with_its_block_at_the_border():
    # Half the image is 4.66 wide at this distance. The node's σ is 15 px, its centre 30 px out of it, its leaves are specks.
    camera = Camera.look_at(np.array([0.0, 0.0, -10.0]), np.zeros(3), width=1000, height=1000)
    pixel = 10 / camera.K[0, 0]
    for out, seen in ((30.0, True), (60.0, False)):
        scene = pairs_of_leaves(np.array([[(500 + out) * pixel, 0, 0]]), np.array([15 * pixel]))
        assert select(scene, camera, SelectOptions(pixel_error=60.0)).rows.tolist() == [0] * seen


def test_work_follows_what_can_be_seen():
    scene = city(150)
    centre = np.array([75.0, 75.0, 0.0])

    def visited(height: float) -> tuple[int, int]:
        camera = Camera.look_at(centre - [0, 0, height], centre, width=400, height=400)
        found = select(scene, camera)
        return found.num_visited, len(found)

    near, far = visited(10.0), visited(1000.0)
    # 400 rows are seen, in 9 rows of the grid; each of these takes a block or two of 51 roots.
    assert near[1] == 400
    assert near[0] <= 9 * 3 * 256
    assert far[0] > 0.95 * len(scene)  # all but the leaves of roots at the end of a block that stop there
    away = Camera.look_at(centre - [0, 0, 10.0], centre - [0, 0, 20.0])
    assert select(scene, away).num_visited == 0


def test_shadowed_blocks_are_passed_over():
    # One root above 4000 leaves: far away it is drawn alone, and of the other blocks none is looked at.
    n = 4001
    rng = np.random.default_rng(0)
    end = np.arange(1, n + 1, dtype=np.int32)
    end[0] = n
    depth = np.ones(n, np.uint8)
    depth[0] = 0
    columns = (rng.normal(size=(n, 3)), rng.normal(size=(n, 4)), np.full((n, 3), -1), np.ones(n), np.zeros((n, 1, 3)))
    gaussians = Gaussians(*(column.astype(np.float32) for column in columns))
    scene = with_blocks(Scene(gaussians, GaussianTree(end, depth, np.full(n, 9, np.float32))))
    found = select(scene, Camera.look_at(np.array([0.0, 0.0, -1e4]), np.zeros(3)))
    assert found.rows.tolist() == [0]
    assert found.num_visited == scene.blocks.rows_per_block


def test_rows_that_are_not_finite_are_never_drawn():
    scene = city(12)
    means = scene.gaussians.means.copy()
    means[[1, 7, 33]] = np.nan, np.inf, -np.inf
    camera = Camera.look_at(np.array([6.0, 6.0, -9.0]), np.array([6.0, 6.0, 0.0]))
    broken = replace(scene, gaussians=replace(scene.gaussians, means=means), blocks=None)
    rows = select(broken, camera, SelectOptions(pixel_error=0)).rows
    wanted = np.setdiff1d(select(scene, camera, SelectOptions(pixel_error=0)).rows, [1, 7, 33])
    assert rows.tolist() == wanted.tolist()


@pytest.mark.parametrize("profile", EXTENT_PROFILES)
def test_a_merged_row_without_a_place_is_refined(profile):
    scene = city(12)
    camera = Camera.look_at(np.array([6.0, 6.0, -9.0]), np.array([6.0, 6.0, 0.0]), width=4000, height=4000)
    coarse = SelectOptions(pixel_error=1e4, profile=profile)
    whole = select(scene, camera, coarse).rows
    root = int(whole[len(whole) // 2])
    means = scene.gaussians.means.copy()
    means[root, 1] = np.nan
    broken = replace(scene, gaussians=replace(scene.gaussians, means=means), blocks=None)
    wanted = np.sort(np.concatenate([np.setdiff1d(whole, root), np.arange(root + 1, root + 5)]))
    assert select(broken, camera, coarse).rows.tolist() == wanted.tolist()
    classes = index_blocks(broken.gaussians, broken.tree).size_classes
    assert classes[root] == 254 > classes[whole[0]]
    np.testing.assert_array_equal(classes, reference_blocks.index_blocks(broken.gaussians, broken.tree).size_classes)


def test_a_scene_without_one_finite_mean_has_nothing_to_draw():
    gaussians = city(3).gaussians
    lost = replace(gaussians, means=np.full_like(gaussians.means, np.nan))
    assert len(select(with_blocks(Scene.flat(lost)), random_camera(0))) == 0


def test_a_world_far_from_its_origin_loses_nothing():
    # Map coordinates of 500 km have steps of 3 cm in float32; given such means, no further rounding comes on top.
    scene = city(20)
    shift = np.array([500_000.0, 4_000_000.0, 100.0])
    means = (scene.gaussians.means + shift).astype(np.float32)
    moved = replace(scene, gaussians=replace(scene.gaussians, means=means), blocks=None)
    camera = Camera.look_at(shift + [10.0, 10.0, -12.0], shift + [10.0, 10.0, 0.0])
    options = SelectOptions(pixel_error=60.0)
    assert_is_the_cut(select(moved, camera, options).rows, moved, camera, options, 0.3)
