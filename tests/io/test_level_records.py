"""How levels were made travels with the tree: through joining, editing and files."""

import json
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.rad.container import open_rad
from splatree.io.joined import joined
from splatree.kernels.reference.select import radii
from splatree.lod.link import link_levels
from splatree.scene.levels import UNKNOWN_LEVELS, LevelRecord

from ..lod.test_select import camera_at
from ..scenes import surface, with_balls
from .test_store import rewrite

PAIRS, RADIUS = st.BuildOptions(method="pairs"), st.BuildOptions(radius=0.2)


def tree(options=PAIRS, seed=0, n=800):
    return st.build_lod(st.Scene.flat(surface(n, seed=seed, degree=1)), options)


def linked():
    fine = surface(600, seed=3)
    return link_levels([st.Scene.flat(fine), st.Scene.flat(fine.take(np.arange(0, 600, 5)))])


MADE = {"pairs": tree, "radius": lambda: tree(RADIUS), "linked": linked}


@pytest.mark.parametrize("made", MADE)
def test_joined_trees_are_drawn_as_each_alone(made):
    first, second = MADE[made](), MADE[made]()
    both, camera = joined([first, second]), camera_at(12.0)
    alone = [st.select(scene, camera).rows for scene in (first, second)]
    drawn = st.select(both, camera)
    np.testing.assert_array_equal(drawn.rows, np.concatenate([alone[0], alone[1] + len(first)]))
    assert both.tree.record == first.tree.record and drawn.profile == first.tree.record.profile


def test_sizes_of_levels_of_joined_trees_are_listed_together_and_what_differs_is_left_out():
    coarse = st.BuildOptions(radius=0.3, growth=3.0)
    parts = [tree(RADIUS), tree(coarse, seed=1)]
    record = joined(parts).tree.record
    assert record.steps == tuple(sorted({step for part in parts for step in part.tree.record.steps}))
    assert record.growth is None and record.rule == "radius-thinning" and record.importance == "opacity-scale"
    assert record.merge is None  # the dilation follows from the growth
    assert record.profile == "pixel"


def test_joined_trees_of_different_rules_are_mixed():
    record = joined([tree(RADIUS), tree(PAIRS)]).tree.record
    assert (record.rule, record.profile, record.mode) == ("mixed", "pixel", "classic")


@pytest.mark.parametrize("other", [linked, lambda: with_balls(tree(RADIUS))])
def test_joined_trees_of_different_profiles_are_drawn_by_spheres(other):
    assert joined([tree(RADIUS), other()]).tree.record.profile == "sphere"


def test_files_of_before_are_drawn_as_before(tmp_path):
    """Their record says how: each node by its size on the screen, whatever the rule that made them."""
    scene, camera = with_balls(tree(RADIUS)), camera_at(12.0)
    options = st.SelectOptions(pixel_error=20)
    for suffix in (".splatree", ".rad"):
        st.write(scene, tmp_path / f"a{suffix}")
        back = st.read(tmp_path / f"a{suffix}")
        assert back.tree.record == scene.tree.record
        chosen = st.select(back, camera, options)
        assert chosen.profile == "exact"
        if suffix == ".splatree":
            sizes = radii(back.gaussians, back.tree.extents, camera, "exact", 0.3)
            inner = chosen.rows[~back.tree.is_leaf[chosen.rows]]
            assert len(inner) and (sizes[inner] <= 20 * (1 + 1e-4)).all()
            assert back.tree.extents.tobytes() == scene.tree.extents.tobytes()


def test_a_scene_without_levels_goes_with_any():
    one = tree()
    assert joined([one, st.Scene.flat(surface(9, degree=1)), one]).tree.record == one.tree.record
    assert joined([st.Scene.flat(surface(9))] * 2).tree.record is None


def test_levels_without_a_record_are_of_an_unknown_rule():
    one = tree(RADIUS)
    unknown = replace(one, tree=replace(one.tree, record=None))
    assert joined([unknown, unknown]).tree.record == UNKNOWN_LEVELS


@pytest.mark.parametrize("made", MADE)
def test_the_native_format_keeps_the_record(tmp_path, made):
    scene = MADE[made]()
    assert not any("drawn" in sentence for sentence in st.write(scene, tmp_path / "a.splatree"))
    assert st.read(tmp_path / "a.splatree").tree.record == scene.tree.record


@pytest.mark.parametrize("made", MADE)
def test_older_native_files_say_it_in_their_provenance(tmp_path, made):
    scene = MADE[made]()
    if made == "radius":
        scene = with_balls(scene)
    parts = [scene, joined([scene, scene])]
    if made == "radius":
        parts.append(joined([scene, with_balls(tree(replace(RADIUS, radius=0.3)))]))
    for part in parts:
        st.write(part, tmp_path / "a.splatree", force=True)
        rewrite(tmp_path / "a.splatree", lambda header: header["__metadata__"].pop("tree.record"))
        found = st.read(tmp_path / "a.splatree").tree.record
        assert found == (replace(part.tree.record, mode=None) if made == "linked" else part.tree.record)


@pytest.mark.parametrize("text", ["", "[]", '"linked"', '{"rule": 3}', '{"rule": "grow"}', '["linked"]', '{"rule"'])
def test_other_provenance_says_nothing(tmp_path, text):
    scene = tree(RADIUS)
    source = replace(scene.source, metadata={"levels": text})
    st.write(replace(scene, source=source), tmp_path / "a.splatree")
    rewrite(tmp_path / "a.splatree", lambda header: header["__metadata__"].pop("tree.record"))
    assert st.read(tmp_path / "a.splatree").tree.record == UNKNOWN_LEVELS


@pytest.mark.parametrize("text", ["{}", "[1]", "{", '{"rule": "grow", "profile": "exact"}', '{"rule": "pairs"}'])
def test_a_damaged_record_is_refused(tmp_path, text):
    st.write(tree(RADIUS), tmp_path / "a.splatree")
    rewrite(tmp_path / "a.splatree", lambda header: header["__metadata__"].update({"tree.record": text}))
    with pytest.raises(st.FormatError, match="record"):
        st.read(tmp_path / "a.splatree")


@pytest.mark.parametrize("compression", [0, 1, 2])
@pytest.mark.parametrize("made", MADE)
def test_rad_keeps_the_record_and_what_the_profile_asks(tmp_path, made, compression):
    scene = MADE[made]()
    lost = st.write(scene, tmp_path / "a.rad", options=st.WriteOptions(compression=compression))
    assert not any("drawn" in sentence for sentence in lost)
    back, inner = st.read(tmp_path / "a.rad"), ~scene.tree.is_leaf
    assert back.tree.record == scene.tree.record
    np.testing.assert_array_equal(back.tree.extents[inner], scene.tree.extents[inner])
    if compression == 0:
        camera = camera_at(12.0)
        np.testing.assert_array_equal(st.select(back, camera).rows, st.select(scene, camera).rows)


def test_rad_with_extents_of_no_use_is_refused(tmp_path):
    scene = tree()
    st.write(scene, tmp_path / "a.rad")
    data = (tmp_path / "a.rad").read_bytes()
    assert [name for name in open_rad(tmp_path / "a.rad").chunks[0].properties if name == "extent"]
    (tmp_path / "b.rad").write_bytes(data.replace(b'"property":"extent"', b'"property":"alpha" '))
    with pytest.raises(st.FormatError, match="alpha: found it twice"):
        st.read(tmp_path / "b.rad")
    extents = np.where(scene.tree.is_leaf, scene.tree.extents, np.float32(np.nan))
    st.write(replace(scene, tree=replace(scene.tree, extents=extents)), tmp_path / "c.rad")
    with pytest.raises(st.FormatError, match="extents: found nan"):
        st.read(tmp_path / "c.rad")
    assert b'"rule":"pairs"' in data
    (tmp_path / "d.rad").write_bytes(data.replace(b'"rule":"pairs"', b'"rule":"piers"'))
    with pytest.raises(st.FormatError, match="rule: found 'piers'"):
        st.read(tmp_path / "d.rad")


def test_hier_cannot_say_it_and_writing_says_so(tmp_path):
    scene = tree()
    lost = st.write(scene, tmp_path / "a.hier")
    assert any(s.startswith("how levels are drawn: they were made by the rule pairs") for s in lost)
    back = st.read(tmp_path / "a.hier")
    assert back.tree.record == UNKNOWN_LEVELS
    # Another program's levels are drawn by the size of each merged Gaussian: never coarser than these levels were made for.
    assert st.select(back, camera_at(12.0)).profile == "exact"
    assert not any("drawn" in sentence for sentence in st.write(back, tmp_path / "b.hier"))
    assert not any("drawn" in sentence for sentence in st.write(scene, tmp_path / "a.ply"))


def test_scaling_a_scene_scales_the_sizes_of_its_levels():
    scene = tree(RADIUS)
    scaled = st.edit(scene, st.EditOptions(scale=10.0))
    assert scaled.tree.record == scene.tree.record.scaled(10.0)
    assert scaled.tree.record.steps[0] == pytest.approx(2.0)


def test_leaving_rows_out_and_clustering_keep_the_record():
    scene = tree()
    cropped = st.edit(scene, st.EditOptions(crop_sphere=(0, 0, 0, 3)))
    assert len(cropped) < len(scene) and cropped.tree.record == scene.tree.record
    assert st.build_clusters(scene).tree.record == scene.tree.record


def test_records_are_checked_and_go_through_json():
    record = tree().tree.record
    assert LevelRecord.from_json(record.to_json()) == record
    assert json.loads(record.to_json())["profile"] == "pixel"
    for wrong, message in (
        ({"rule": "grow"}, "rule: found 'grow'"),
        ({"profile": "oval"}, "profile: found 'oval'"),
        ({"mode": "blurry"}, "mode: found 'blurry'"),
        ({"steps": (0.2, 0.1)}, "ascending"),
        ({"steps": (-1.0,)}, "0 or more"),
        ({"growth": 1.0}, "growth: found 1.0"),
        ({"color_radius": -1.0}, "color_radius"),
    ):
        with pytest.raises(st.InputError, match=message):
            replace(record, **wrong)
