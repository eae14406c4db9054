from pathlib import Path

import numpy as np
import pytest

import splatree as st

from ..scenes import camera, gaussians


def test_counters_add_up_to_those_of_the_frame(tmp_path: Path) -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(400, 1, spread=3.0)), 30)
    frame = st.trace(scene, camera())
    found, total = st.frame_counters(scene, frame), frame.result.counters
    assert found.cluster_rows.sum() == 400
    assert found.cluster_survivors.sum() == total.num_visible
    assert found.cluster_pairs.sum() == found.tile_length.sum() == total.num_pairs
    assert found.tile_evaluated.sum() == total.num_evaluated
    assert found.tile_blended.sum() == total.num_blended
    assert np.all(found.tile_consumed <= found.tile_length)
    assert found.num_tiles_xy.prod() == len(found.tile_length)
    # What step 0 left out has no survivors, and what survived lies in its cluster.
    assert not found.cluster_survivors[~found.cluster_kept].any()
    assert 0 < found.cluster_kept.sum() < 30
    first, last = scene.clusters.start[:-1], scene.clusters.start[1:]
    inside = (frame.splats.rows[:, None] >= first) & (frame.splats.rows[:, None] < last)
    np.testing.assert_array_equal(inside.sum(axis=0), found.cluster_survivors)

    st.write_counters(found, str(tmp_path / "a.npz"))
    with np.load(tmp_path / "a.npz") as back:
        for name, value in vars(found).items():
            np.testing.assert_array_equal(back[name], value)
    with pytest.raises(st.OutputError, match="exists"):
        st.write_counters(found, tmp_path / "a.npz")


def test_a_scene_without_clusters_is_counted_by_tile() -> None:
    scene = st.Scene.flat(gaussians(100, 2))
    found = st.frame_counters(scene, st.trace(scene, camera()))
    assert len(found.cluster_rows) == len(found.cluster_kept) == len(found.cluster_pairs) == 0
    assert found.tile_length.sum() > 0
