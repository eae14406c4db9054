"""A scene that is built in parts: growth that goes on above parts gives the tree of a build at once, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.lod.assemble import assemble
from splatree.lod.forest import forest_of_leaves, forest_of_roots
from splatree.lod.graft import graft
from splatree.lod.grow import grow
from splatree.lod.resolve import ResolvedBuild, measure, resolve

from ..scenes import surface

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
MODES = hs.sampled_from(["classic", "antialiased"])


def resolved_for(scene, options):
    return resolve(options, measure(scene.gaussians, options, scene.mode), scene.mode)


def built_in_parts(scene, options, part_from_row, num_levels):
    """The tree by way of parts; every number of ``part_from_row`` is one part."""
    resolved = resolved_for(scene, options)
    parts = []
    for number in np.unique(part_from_row):
        inputs = np.flatnonzero(part_from_row == number)
        flat = replace(st.Scene.flat(scene.gaussians.take(inputs), mode=scene.mode), threshold=scene.threshold)
        forest = grow(forest_of_leaves(flat, resolved, inputs=inputs), resolved, num_levels=num_levels)
        parts.append(assemble(forest, flat, resolved))
    return graft(grow(forest_of_roots(parts, resolved), resolved), parts, resolved)


def check_same_tree(found, wanted):
    for name in COLUMNS:
        assert getattr(found.gaussians, name).tobytes() == getattr(wanted.gaussians, name).tobytes(), name
    for name in ("subtree_end", "depth", "extents"):
        assert getattr(found.tree, name).tobytes() == getattr(wanted.tree, name).tobytes(), name
    is_leaf = wanted.tree.is_leaf
    np.testing.assert_array_equal(found.ids[is_leaf], wanted.ids[is_leaf])
    assert len(np.unique(found.ids)) == len(found)
    assert found.tree.record == wanted.tree.record
    for name in ("weights", "reaches", "codes", "inputs"):
        np.testing.assert_array_equal(getattr(found.tree.roots, name), getattr(wanted.tree.roots, name))


def islands(seed, num_islands, degree=1):
    """Patches far apart from each other, with their rows shuffled, and the patch of each row."""
    rng = np.random.default_rng(seed)
    patches = [surface(int(rng.integers(1, 120)), seed=seed + i, degree=degree) for i in range(num_islands)]
    moved = [
        replace(patch, means=patch.means + np.float32([1000.0 * i, 300.0 * (i % 2), 0]))
        for i, patch in enumerate(patches)
    ]
    order = rng.permutation(sum(map(len, patches)))
    island = np.repeat(np.arange(num_islands), [len(patch) for patch in patches])
    return st.Gaussians.concatenate(moved).take(order), island[order]


@settings(max_examples=30)
@given(hs.integers(0, 10**6), hs.integers(1, 5), hs.integers(0, 4), MODES, hs.integers(1, 3))
def test_parts_out_of_reach_of_each_other_give_the_tree_of_a_build_at_once(
    seed, num_islands, num_levels, mode, num_parts
):
    gaussians, island = islands(seed, num_islands)
    scene = st.Scene.flat(gaussians, mode=mode)
    options = st.BuildOptions(follow=False, visibility=False, radius=0.3, max_roots=1)
    part_from_row = island % num_parts  # each part holds whole islands
    check_same_tree(built_in_parts(scene, options, part_from_row, num_levels), st.build_lod(scene, options))


@settings(max_examples=30)
@given(hs.integers(1, 300), hs.integers(0, 10**6), hs.integers(0, 6), MODES)
def test_growth_goes_on_where_it_stopped(n, seed, num_levels, mode):
    scene = st.Scene.flat(surface(n, seed=seed, degree=1), mode=mode)
    options = st.BuildOptions(follow=False, visibility=False, radius=0.2, max_roots=1, growth=1.7)
    check_same_tree(built_in_parts(scene, options, np.zeros(n, int), num_levels), st.build_lod(scene, options))


def test_parts_go_through_files(tmp_path):
    gaussians, island = islands(3, 3, degree=2)
    scene, options = st.Scene.flat(gaussians), st.BuildOptions(follow=False, visibility=False, radius=0.3, max_roots=2)
    resolved = ResolvedBuild.from_json(resolved_for(scene, options).to_json())
    paths = []
    for number in range(3):
        inputs = np.flatnonzero(island == number)
        flat = st.Scene.flat(gaussians.take(inputs))
        forest = grow(forest_of_leaves(flat, resolved, inputs=inputs), resolved, num_levels=2)
        paths.append(tmp_path / f"{number}.splatree")
        st.write(assemble(forest, flat, resolved), paths[-1])
    parts = [st.read(path) for path in reversed(paths)]  # parts may come in any order
    check_same_tree(
        graft(grow(forest_of_roots(parts, resolved), resolved), parts, resolved), st.build_lod(scene, options)
    )


@pytest.mark.parametrize("said", [None, False])
def test_above_parts_without_visibilities_distance_alone_decides(said, tmp_path):
    """Files of before say nothing of visibilities; their roots were all written as seen."""
    gaussians, island = islands(3, 3)
    scene, options = st.Scene.flat(gaussians), st.BuildOptions("radius", follow=False, radius=0.3, max_roots=1)
    today, before = (resolved_for(scene, replace(options, visibility=seen)) for seen in (True, False))
    parts = []
    for number, resolved in enumerate((before, before, today)):
        inputs = np.flatnonzero(island == number)
        flat = st.Scene.flat(gaussians.take(inputs))
        part = assemble(grow(forest_of_leaves(flat, resolved, inputs=inputs), resolved, num_levels=2), flat, resolved)
        assert part.tree.record.visibility == (resolved is today)
        if resolved is before:
            part = replace(part, tree=replace(part.tree, record=replace(part.tree.record, visibility=said)))
        path = tmp_path / f"{number}.splatree"
        st.write(part, path)
        parts.append(st.read(path))
    assert [part.tree.record.visibility for part in parts] == [said, said, True]
    assert forest_of_roots(parts[2:], today).visibilities is not None
    top = forest_of_roots(parts, today)
    assert top.visibilities is None
    tree = graft(grow(top, today), parts, today)
    assert tree.tree.record.visibility is None  # nothing that holds for all of it
    alone = graft(grow(forest_of_roots(parts[:2], today), today), parts[:2], today)
    wanted = graft(grow(forest_of_roots(parts[:2], before), before), parts[:2], before)
    for name in COLUMNS:
        assert getattr(alone.gaussians, name).tobytes() == getattr(wanted.gaussians, name).tobytes(), name


@pytest.mark.parametrize("method", ["radius", "pairs"])
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_neighbouring_parts_give_a_sound_tree(method, mode):
    """Parts that touch are merged by themselves first: the tree is another one, but every leaf and all weight is in it."""
    scene = st.Scene.flat(surface(900, seed=5, degree=1), mode=mode)
    options = st.BuildOptions(follow=False, method=method, max_roots=4)
    part_from_row = (scene.gaussians.means[:, 0] > 0) + 2 * (scene.gaussians.means[:, 1] > 0)
    tree = built_in_parts(scene, options, part_from_row, 3)
    leaves = np.flatnonzero(tree.tree.is_leaf)
    assert sorted(tree.ids[leaves]) == list(range(900))
    for name in COLUMNS:
        assert (
            getattr(tree.gaussians, name)[leaves].tobytes()
            == getattr(scene.gaussians, name)[tree.ids[leaves]].tobytes()
        )
    whole = st.build_lod(scene, options)
    assert (tree.tree.depth == 0).sum() <= 4 and tree.tree.record.profile == whole.tree.record.profile
    if method == "radius":
        np.testing.assert_allclose(tree.tree.roots.weights.sum(), whole.tree.roots.weights.sum(), rtol=1e-5)
    camera = st.orbit(whole, st.PathOptions(views=1, width=160, height=90))[0]
    pictures = [st.render(s, camera, select=st.SelectOptions(pixel_error=3.0)).image for s in (tree, whole)]
    leaves_alone = st.render(whole, camera, select=st.SelectOptions(pixel_error=0.0)).image
    assert st.psnr(pictures[0], leaves_alone) > st.psnr(pictures[1], leaves_alone) - 1.5


def test_parts_of_other_builds_are_refused():
    scene = st.Scene.flat(surface(200, seed=1))
    options = st.BuildOptions(follow=False, visibility=False, radius=0.3, max_roots=1)
    resolved = resolved_for(scene, options)
    part = assemble(grow(forest_of_leaves(scene, resolved), resolved, num_levels=1), scene, resolved)
    later = assemble(grow(forest_of_leaves(scene, resolved), resolved, num_levels=2), scene, resolved)
    with pytest.raises(st.InputError, match="found none"):
        forest_of_roots([], resolved)
    with pytest.raises(st.InputError, match=r"parts grown to \[1, 2\] sizes"):
        forest_of_roots([part, later], resolved)
    with pytest.raises(st.InputError, match="part 1: found a part of another build"):
        forest_of_roots([part, replace(part, mode="antialiased")], resolved)
    with pytest.raises(st.InputError, match="part 0: found a part of another build"):
        forest_of_roots([part], replace(resolved, log_unit=resolved.log_unit + 1))
    with pytest.raises(st.InputError, match="does not know the state of its roots"):
        forest_of_roots([scene], resolved)
    top = grow(forest_of_roots([part], resolved), resolved)
    with pytest.raises(st.InputError, match="wanted the"):
        graft(top, [part, part], resolved)
    with pytest.raises(st.InputError, match=r"part 1: found threshold 0\.5"):
        halves = forest_of_roots([part, part], resolved)
        graft(halves, [part, replace(part, threshold=0.5)], resolved)
    with pytest.raises(st.InputError, match=r"resolved build: found '\{\}'"):
        ResolvedBuild.from_json("{}")
