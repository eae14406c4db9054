"""What goes through a folder in runs of rows gives what the whole tree in memory gives."""

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.folder import whole
from splatree.io.formats.splatree.container import open_container


@pytest.fixture
def short_runs(monkeypatch):
    """Runs of a few rows, which begin and end anywhere in the subtrees of parts."""
    monkeypatch.setattr(whole, "ROWS_PER_CHUNK", 97)


def test_any_run_of_rows_is_that_of_the_whole_tree(folder, scene):
    tree, n = whole.open_whole(folder), len(scene)
    assert (len(tree), tree.num_leaves) == (n, scene.tree.num_leaves)
    rng = np.random.default_rng(0)
    for begin, end in [(0, n), (0, 0), (n, n), *(sorted(rng.integers(0, n, 2)) for _ in range(20))]:
        run, wanted = tree.rows(int(begin), int(end)), st.SceneRows.of(scene)
        assert run.gaussians.sh.tobytes() == wanted.gaussians.sh[begin:end].tobytes()
        assert run.gaussians.means.tobytes() == wanted.gaussians.means[begin:end].tobytes()
        for name in ("subtree_end", "depth", "extents", "ids"):
            assert getattr(run, name).tobytes() == getattr(wanted, name)[begin:end].tobytes(), name


def test_a_folder_becomes_one_file_with_the_bytes_of_the_tree_in_memory(folder, scene, tmp_path, short_runs):
    done = st.convert(folder, tmp_path / "by_runs.splatree")
    assert (done.in_chunks, done.num_written, done.lost) == (True, scene.tree.num_leaves, ())
    st.write(scene, tmp_path / "whole.splatree")
    found, wanted = (open_container(tmp_path / f"{name}.splatree") for name in ("by_runs", "whole"))
    assert dict(found.columns) == dict(wanted.columns)
    assert dict(found.values) == dict(wanted.values)
    assert (tmp_path / "by_runs.splatree").read_bytes() == (tmp_path / "whole.splatree").read_bytes()


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".splat", ".ksplat", ".sog", ".glb"])
def test_leaves_of_a_folder_become_the_file_of_the_tree_in_memory(folder, scene, tmp_path, suffix):
    done = st.convert(folder, tmp_path / f"by_runs{suffix}")
    lost = st.write(scene, tmp_path / f"whole{suffix}")
    assert (done.in_chunks, done.num_written, done.lost) == (True, scene.tree.num_leaves, lost)
    assert (tmp_path / f"by_runs{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


def test_leaves_are_edited_on_the_way(folder, scene, tmp_path, short_runs):
    edits = st.EditOptions(scale=2, rotate=(90, 0, 0), min_opacity=0.3, sh_degree=1)
    done = st.convert(folder, tmp_path / "by_runs.ply", st.ConvertOptions(edit=edits))
    st.write(st.edit(scene, edits), tmp_path / "whole.ply")
    assert 0 < done.num_written < done.num_read
    assert (tmp_path / "by_runs.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize(("name", "edits"), [("tree.hier", {"translate": (1, 0, 0)}), ("tree.rad", {})])
def test_what_needs_the_tree_in_memory_gives_the_same_file(folder, scene, tmp_path, name, edits):
    edits = st.EditOptions(**edits)
    done = st.convert(folder, tmp_path / name, st.ConvertOptions(edit=edits))
    assert not done.in_chunks
    st.write(st.edit(scene, edits), tmp_path / f"whole_{name}")
    assert (tmp_path / name).read_bytes() == (tmp_path / f"whole_{name}").read_bytes()
