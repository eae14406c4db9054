import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.lod.test_build import NAMES, check_moments, parents_of
from tests.scenes import surface

from splatree import BuildOptions, Gaussians, InputError, MergeOptions, Scene, build_lod
from splatree.kernels.cpu.build.partners import FOUND, STALE
from splatree.kernels.cpu.build.thin import group
from splatree.kernels.reference import merge as reference_merge
from splatree.kernels.reference import pairs as reference
from splatree.lod.assemble import assemble
from splatree.lod.forest import forest_of_leaves, forest_of_roots
from splatree.lod.graft import graft
from splatree.lod.grow import grow
from splatree.lod.grow_pairs import JUDGED_POWER, grow_part_by_pairs, judged_at
from splatree.lod.present import (
    CHANGE,
    LARGE,
    LAST_SHARE,
    ROUND_SHARE,
    SATURATED,
    SMALL,
    Present,
)
from splatree.lod.region import EVERYWHERE, Region
from splatree.lod.resolve import JUDGED_SIZE, measure, resolve
from splatree.maths.covariance import covariances_from_gaussians
from splatree.simplify.merge import weights_of

PAIRS = BuildOptions("pairs")


@pytest.mark.parametrize("growth", [1.1, 2.0, 3.0])
def test_coarse_levels_are_closer_together(growth):
    """By √2 from 8 p_0 on and by 2^¼ from 32 p_0 on, unless they are closer together already."""
    options = BuildOptions("pairs", pixel_size=0.25, growth=growth)
    leaves = surface(50)
    resolved = resolve(options, measure(leaves, options, "classic"), "classic")
    sizes = np.array(list(resolved.sizes()))
    assert sizes[0] == 0.25 and resolved.judged_size == 1
    assert sizes[-2] <= resolved.last_size < sizes[-1] and resolved.last_size > 64
    for size, factor in zip(sizes[:-1], sizes[1:] / sizes[:-1], strict=True):
        most = 3.0 if size < 7.9 else 2**0.5 if size < 31.9 else 2**0.25
        assert factor == pytest.approx(min(growth, most))


@given(
    st.builds(surface, st.integers(0, 120), st.integers(0, 1000), st.sampled_from([0, 2])),
    st.sampled_from(["classic", "antialiased"]),
    st.integers(1, 10),
)
def test_leaves_are_the_input_and_inner_nodes_have_two_children_or_more(gaussians, mode, max_roots):
    scene = build_lod(Scene.flat(gaussians, mode=mode), replace(PAIRS, max_roots=max_roots))
    leaves = np.flatnonzero(scene.tree.is_leaf)
    for name in NAMES:
        given_column = getattr(gaussians, name)[scene.ids[leaves]]
        assert getattr(scene.gaussians, name)[leaves].tobytes() == given_column.tobytes()
    parents = parents_of(scene)
    assert (np.bincount(parents[parents >= 0], minlength=len(scene))[~scene.tree.is_leaf] >= 2).all()
    assert (parents < 0).sum() <= max(max_roots, min(len(gaussians), 1))


def test_the_extent_of_a_node_is_three_pixels_of_its_level():
    scene = build_lod(Scene.flat(surface(500)), replace(PAIRS, pixel_size=0.25, growth=1.5))
    record = json.loads(scene.source.metadata["levels"])
    assert record["rule"] == "pairs"
    assert record["nodes"][0] == 500
    inner = ~scene.tree.is_leaf
    sizes = 3 * np.array(record["pixel_sizes"])
    np.testing.assert_array_equal(np.unique(scene.tree.extents[inner]), np.unique(sizes).astype(np.float32))
    parents = parents_of(scene)
    below = inner & (parents >= 0)
    assert (scene.tree.extents[parents[below]] > scene.tree.extents[below]).all()


@given(st.floats(1e-6, 1e-3), st.integers(0, 9))
def test_coarse_levels_are_judged_at_a_finer_pixel_than_their_size_and_fine_ones_at_a_wider(first, level):
    options = replace(PAIRS, pixel_size=first)
    resolved = resolve(options, measure(surface(10), options, "classic"), "classic")
    size = next(resolved.sizes_from(level))
    judged = judged_at(size, resolved)
    middle = JUDGED_SIZE * first
    assert np.sign(size - judged) == np.sign(size - middle)
    np.testing.assert_allclose(judged / middle, max(1, size / middle) ** JUDGED_POWER, rtol=1e-9)


@pytest.mark.parametrize("distance", [0.01, 0.3, 1.0])
def test_two_become_one_at_the_first_size_of_a_pixel_that_does_not_show_it(distance):
    g = surface(2, seed=3)
    means = np.array([[0, 0, 0], [distance, 0, 0]], np.float32)
    g = Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh)
    weights = weights_of(g, "opacity-area")
    cost = reference.pair_costs(g, weights, np.array([0]), np.array([1]), dilation=0.0)[0][0]
    options = replace(PAIRS, pixel_size=1e-3, growth=1.25, max_roots=1, visibility=False)
    scene = build_lod(Scene.flat(g, mode="antialiased"), options)
    (pixel_size,) = json.loads(scene.source.metadata["levels"])["pixel_sizes"]
    assert CHANGE * (pixel_size / 1.25) ** 2 < cost <= CHANGE * pixel_size**2


def test_what_is_hidden_is_merged_earlier_than_what_is_seen():
    hidden, seen = surface(400, seed=2), surface(400, seed=2)
    cover = Gaussians(
        hidden.means + np.float32([0, 0, 0.6]),
        hidden.quats,
        hidden.log_scales + np.float32([1, 1, 0]),
        np.full(400, 9, np.float32),
        hidden.sh,
    )
    below = Gaussians(
        hidden.means - np.float32([0, 0, 0.6]), cover.quats, cover.log_scales, cover.logit_opacities, hidden.sh
    )
    sandwich = Gaussians.concatenate([hidden, cover, below])

    def mean_extent(scene: Scene) -> float:
        """Of the parents of the first 400."""
        parents = parents_of(scene)
        rows = np.flatnonzero(scene.tree.is_leaf & (scene.ids < 400) & (parents >= 0))
        return float(np.mean(np.log(scene.tree.extents[parents[rows]])))

    extents = [mean_extent(build_lod(Scene.flat(g), replace(PAIRS, pixel_size=0.05 / 8))) for g in (sandwich, seen)]
    assert extents[0] < extents[1] - 0.2  # found: 0.28


def test_a_large_node_waits_for_large_pixels_however_little_it_changes():
    g = surface(1, seed=1)
    rows = np.zeros(2, np.int64)
    sh = np.zeros((2, 1, 3), np.float32)
    twins = Gaussians(g.means[rows], g.quats[rows], g.log_scales[rows] + 9, np.full(2, -9, np.float32), sh)
    scene = build_lod(Scene.flat(twins, mode="antialiased"), replace(PAIRS, pixel_size=1e-3, growth=1.25, max_roots=1))
    (pixel_size,) = json.loads(scene.source.metadata["levels"])["pixel_sizes"]
    sigma = float(np.exp(twins.log_scales.max()))
    assert LARGE * pixel_size / 1.25 < sigma <= 1.0001 * LARGE * pixel_size


def test_an_inner_node_has_the_mean_and_covariance_of_its_leaves():
    options = replace(
        PAIRS, max_roots=4, merge=MergeOptions(opacity="union", weight="opacity"), visibility=False, follow=False
    )
    check_moments(build_lod(Scene.flat(surface(300, degree=1)), options), num_merges=30)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_result_does_not_depend_on_threads(mode):
    flat = Scene.flat(surface(2000, degree=1), mode=mode)
    one, two = (build_lod(flat, PAIRS, threads=threads) for threads in (1, 2))
    for name in NAMES:
        assert getattr(one.gaussians, name).tobytes() == getattr(two.gaussians, name).tobytes()
    for name in ("subtree_end", "depth", "extents"):
        assert getattr(one.tree, name).tobytes() == getattr(two.tree, name).tobytes()


class Slow:
    """Levels by definition, over the reference of pairs, a row at a time."""

    def __init__(self, gaussians: Gaussians, weights: np.ndarray, mode: str, options: MergeOptions) -> None:
        self.g, self.weights, self.mode, self.options = gaussians, weights, mode, options
        self.candidates: list[list[int]] = [[] for _ in range(len(gaussians))]
        self.partners: dict[int, tuple[int, float, float]] = {}

    def nearest(self, row: int, others: np.ndarray) -> list[int]:
        apart = np.sum((self.g.means[others] - self.g.means[row]) ** 2, axis=1)
        return list(others[np.argsort(apart, kind="stable")][: reference.NUM_NEIGHBORS])

    def find_partner(self, row: int, dilation: float) -> tuple[int, float, float]:
        others = np.array(self.candidates[row])
        rows = np.full(len(others), row)
        costs, opacities = reference.pair_costs(self.g, self.weights, rows, others, dilation=dilation)
        best = int(np.argmin(costs))
        return int(others[best]), costs[best], opacities[best]

    def sigma(self, i: int, j: int) -> float:
        share = self.weights[j] / (self.weights[i] + self.weights[j])
        both = covariances_from_gaussians(self.g.quats[[i, j]], self.g.log_scales[[i, j]])
        apart = (self.g.means[j] - self.g.means[i]).astype(np.float64)
        merged = (1 - share) * both[0] + share * both[1] + share * (1 - share) * np.outer(apart, apart)
        return float(np.sqrt(np.linalg.eigvalsh(merged)[-1]))

    def merge_level(self, size: float, pixel_size: float, is_frozen: np.ndarray) -> np.ndarray:
        """Where each row went."""
        went, is_classic, n = np.arange(len(self.g)), self.mode == "classic", len(self.g)
        dilation = 0.3 * pixel_size**2 if is_classic else 0.0
        if is_classic:
            self.partners = {}
        for row in range(n):  # who lost more than a quarter of the candidates looks for new ones
            if len(self.candidates[row]) < reference.NUM_NEIGHBORS * 3 // 4:
                self.candidates[row] = self.nearest(row, np.delete(np.arange(n), row))
                self.partners.pop(row, None)
        while len(self.g) - is_frozen.sum() > 1:
            n = len(self.g)
            num_left = n - is_frozen.sum()
            self.partners = {i: self.partners.get(i) or self.find_partner(i, dilation) for i in range(n)}
            representatives, num_pairs = np.full(n, -1, np.int32), 0
            for i in sorted(self.partners, key=lambda i: (self.partners[i][1], i)):
                j, cost, _ = self.partners[i]
                sigma = self.sigma(i, j)
                allowed = cost <= CHANGE * size**2 and sigma <= LARGE * max(size, pixel_size)
                allowed |= is_classic and sigma <= SMALL * pixel_size
                free = representatives[i] < 0 and representatives[j] < 0 and not is_frozen[[i, j]].any()
                if allowed and free and num_pairs <= int(ROUND_SHARE * num_left):
                    representatives[[i, j]] = i
                    num_pairs += 1
            if num_pairs:
                to = self.merge(representatives, dilation)
                went, is_frozen = to[went], is_frozen[np.unique(to, return_index=True)[1]]
            if num_pairs < LAST_SHARE * (len(self.g) - is_frozen.sum()):
                break
        return went

    def merge(self, representatives: np.ndarray, dilation: float) -> np.ndarray:
        alone = representatives < 0
        representatives[alone] = np.flatnonzero(alone)
        groups = group(representatives)
        fitted = np.array([self.partners[i][2] for i in groups.representatives])
        given_opacities = np.where(fitted < SATURATED, fitted, 0) if self.mode == "classic" else None
        options = replace(self.options, dilation=None)
        self.g = reference_merge.merge(self.g, groups, self.weights, options, added=dilation, opacities=given_opacities)
        self.weights = np.add.reduceat(self.weights[groups.rows], groups.start[:-1])
        to = groups.group_from_row
        # A row keeps its partner until one of the two is merged, and its candidates as what they became.
        self.partners = {to[i]: (to[j], c, a) for i, (j, c, a) in self.partners.items() if alone[i] and alone[j]}
        before, self.candidates = self.candidates, []
        for i in range(len(groups)):
            members = groups.rows[groups.start[i] : groups.start[i + 1]]
            found = dict.fromkeys(int(to[c]) for member in members for c in before[member] if to[c] != i)
            kept = list(found)
            if len(kept) > reference.NUM_NEIGHBORS:
                kept = self.nearest(i, np.array(kept))
            self.candidates.append(kept)
        return to


@pytest.mark.parametrize("share_frozen", [0.0, 0.2])
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_levels_are_those_of_the_definition(mode, share_frozen):
    g = surface(50, seed=5)
    frozen = np.random.default_rng(1).random(50) < share_frozen
    options = MergeOptions().resolved(mode, growth=2.0, of_pairs=True)
    weights = weights_of(g, options.weight)
    present = Present(g, weights, np.ones(50, np.float32), mode, options)
    slow = Slow(g, weights, mode, options)
    found = wanted = np.arange(50)
    for sizes in ((0.15, 0.3), (0.5, 0.4), (0.9, 0.5)):
        present.search(0)
        of_present, of_slow = (np.isin(np.arange(went.max() + 1), went[frozen]) for went in (found, wanted))
        found = present.merge_level(*sizes, 1, is_frozen=of_present)[found]
        wanted = slow.merge_level(*sizes, of_slow)[wanted]
        # Of two that are each other's cheapest, rounding says which one stands for both: groups may have other numbers.
        firsts = [np.array([np.flatnonzero(went == group)[0] for group in went]) for went in (found, wanted)]
        np.testing.assert_array_equal(*firsts)
        assert (np.bincount(found)[found[frozen]] == 1).all()
    assert len(np.unique(wanted)) < 40 + 10 * share_frozen


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_partners_kept_from_a_level_of_the_same_pixel_are_those_found_anew(mode):
    """Costs are those of one pixel: who has the candidates of before has the partner of before."""
    g = surface(3000, seed=2)
    options = MergeOptions().resolved(mode, growth=2.0, of_pairs=True)
    kept, anew = (Present(g, weights_of(g, options.weight), np.ones(3000, np.float32), mode, options) for _ in "12")
    for size in (0.2, 0.4, 0.8):
        for present in (kept, anew):
            present.search(0)
        if mode == "classic":
            anew.partners.states[:] = STALE
            assert (kept.partners.states == FOUND).any() == (size > 0.2)
        none = np.zeros(len(kept), bool)
        found, wanted = (present.merge_level(size, 0.01, 1, is_frozen=none) for present in (kept, anew))
        np.testing.assert_array_equal(found, wanted)
        for name in NAMES:
            assert getattr(kept.gaussians, name).tobytes() == getattr(anew.gaussians, name).tobytes()
    assert len(kept) < 1500


def test_gaussians_out_of_reach_of_each_other_stay_roots():
    g = surface(3)
    means = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) * 1e25).astype(np.float32)
    scene = build_lod(
        Scene.flat(Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh)), replace(PAIRS, max_roots=1)
    )
    assert scene.tree.num_leaves == 3


@pytest.mark.parametrize("wrong", [{"method": "triples"}, {"pixel_size": 0.0}, {"pixel_size": float("nan")}])
def test_impossible_options_are_refused(wrong):
    with pytest.raises(InputError):
        BuildOptions(**wrong)


def test_the_record_names_the_rules_that_follow_from_the_mode():
    records = {
        mode: json.loads(build_lod(Scene.flat(surface(200), mode=mode), PAIRS).source.metadata["levels"])
        for mode in ("classic", "antialiased")
    }
    assert records["classic"]["merge"]["opacity"] == "fitted"
    assert records["antialiased"]["merge"]["opacity"] == "optical"
    assert records["classic"]["visibility"]


def leaves_at(scene, is_there, resolved):
    """Some of the Gaussians of a scene, flat and as a forest, all of them seen."""
    inputs = np.flatnonzero(is_there)
    flat, seen = Scene.flat(scene.gaussians.take(inputs), mode=scene.mode), np.ones(len(inputs), np.float32)
    return flat, forest_of_leaves(flat, resolved, inputs=inputs, visibilities=seen)


def test_who_would_be_merged_across_a_border_waits_for_it():
    """Four pairs in a row, the middle one across the border: it waits, and the others are merged as if there was no border."""
    x = np.array([-2.02, -1.98, -0.02, 0.02, 1.98, 2.02, 3.98, 4.02], np.float32)
    g = surface(8, seed=1)
    like = np.zeros(8, int)  # all alike
    g = replace(g.take(like), means=np.stack([x, 0 * x, 0 * x], axis=1))
    scene, options = Scene.flat(g), replace(PAIRS, max_roots=1, follow=False, pixel_size=0.2)
    resolved = resolve(options, measure(g, options, "classic"), "classic")
    left = EVERYWHERE.halved(0, 0.0)[0]
    is_left = left.holds(g.means)
    inside, outside = (leaves_at(scene, side, resolved)[1] for side in (is_left, ~is_left))
    part = grow_part_by_pairs(inside, resolved, Region(left, 10.0), outside, num_levels=1)
    # The pair on the left, and the half of the one in the middle.
    assert part.grown.tolist() == [1, 0] and part.counts == (3, 2)


@given(
    *(st.integers(2, 300), st.integers(0, 1000), st.sampled_from(["classic", "antialiased"]), st.floats(-1, 1)),
    st.sampled_from([0.0, 0.1, 1.0]),
)
def test_parts_that_wait_at_their_border_are_one_scene_with_nothing_lost(n, seed, mode, at, reach):
    scene = Scene.flat(surface(n, seed=seed), mode=mode)
    options = replace(PAIRS, max_roots=1, follow=False)
    resolved = resolve(options, measure(scene.gaussians, options, mode), mode)
    parts = []
    for box in EVERYWHERE.halved(0, at):
        distances, is_inside = box.distances(scene.gaussians.means), box.holds(scene.gaussians.means)
        flat, forest = leaves_at(scene, is_inside, resolved)
        if not len(flat):
            continue
        around = leaves_at(scene, ~is_inside & (distances <= reach), resolved)[1]
        forest = grow_part_by_pairs(forest, resolved, Region(box, reach), around, fewest=n // 16)
        parts.append(assemble(forest, flat, resolved))
    tree = graft(grow(forest_of_roots(parts, resolved), resolved), parts, resolved)
    leaves = np.flatnonzero(tree.tree.is_leaf)
    assert sorted(tree.ids[leaves]) == list(range(n))
    assert (tree.tree.depth == 0).sum() == 1
    parents = parents_of(tree)
    inner = ~tree.tree.is_leaf
    assert (np.bincount(parents[parents >= 0], minlength=len(tree))[inner] >= 2).all()
    below = inner & (parents >= 0)  # who waited was merged at the size that it waited at
    assert (tree.tree.extents[parents[below]] > tree.tree.extents[below]).all()
