"""A folder of parts is described as its tree in memory is."""

from dataclasses import replace

import numpy as np

import splatree as st
from splatree.cli.info import describe
from splatree.io import outline as module
from splatree.io.options import ReadOptions
from splatree.io.outline import outline_of, read_outline


def test_a_folder_is_described_as_its_tree_in_memory(folder, scene, monkeypatch):
    monkeypatch.setattr(module, "FOLDER_RUN", 101)
    found, wanted = describe(read_outline([folder], ReadOptions())), describe(outline_of(scene))
    assert found.in_chunks
    assert replace(found, in_chunks=False) == wanted


def test_of_a_large_folder_leaves_all_over_it_are_looked_at(folder, scene, monkeypatch):
    monkeypatch.setattr(module, "FOLDER_RUN", 101)
    monkeypatch.setattr(module, "FOLDER_SAMPLE", 500)
    monkeypatch.setattr(module, "SAMPLE", 100)
    outline = read_outline([folder], ReadOptions())
    leaves = scene.gaussians.take(scene.tree.is_leaf)
    assert outline.num_leaves == len(leaves)
    assert outline.scene.gaussians.means.tobytes() == leaves.means[:: -(-len(leaves) // 500)].tobytes()
    assert 0 < len(outline.sample) <= 100
    found, wanted = describe(outline), describe(outline_of(scene))
    assert found.num_sampled < found.num_gaussians
    for name in (
        "num_gaussians",
        "num_nodes",
        "levels",
        "nodes_per_depth",
        "box_min",
        "box_max",
        "bytes",
        "file_bytes",
    ):
        assert getattr(found, name) == getattr(wanted, name), name
    assert np.isclose(found.radius, wanted.radius, rtol=0.2)  # a quantile of 500 of 3,000
    assert st.read(folder).source.metadata == outline.scene.source.metadata
