"""Tables of errors: what they say, and what PlayCanvas 2.22 makes of them."""

import dataclasses
import json

import numpy as np
import pytest

import splatree as st
from splatree.stream.boxes import box_around
from splatree.stream.errors import errors_of_levels
from splatree.stream.readers.playcanvas import select_by_errors
from splatree.stream.readers.sog_stream import Ranges, open_sog_stream

from .conftest import forest

CAMERA = st.Camera.look_at([0.5, 0.5, -3.0], [0.5, 0.5, 0.5], width=96, height=64)


def chunk_of(gaussians):
    return box_around(gaussians, np.zeros(1, np.int64), sigmas=1.0)[0]


def test_an_equal_level_has_no_error_and_an_empty_picture_the_error_1():
    g = forest(60, seed=1).gaussians
    nothing = dataclasses.replace(g, logit_opacities=np.full(60, -30, np.float32))
    errors = errors_of_levels([g, g, nothing, g], chunk_of(g), "classic")
    assert errors.tolist() == [0, 0, 1, 1]  # a coarser level is at least as wrong


def test_the_error_of_a_colour_is_a_share_of_rgba():
    """One opaque Gaussian, white against black of the same shape: RGB differ by α, of R² + G² + B² + α² = 4 α²."""
    sh = np.full((1, 1, 3), 0.5 / 0.28209479177387814, np.float32)
    nothing, upright = np.zeros((1, 3), np.float32), np.eye(4, dtype=np.float32)[:1]
    white = st.Gaussians(nothing, upright, nothing, np.full(1, 9, np.float32), sh)
    black = dataclasses.replace(white, sh=-sh)
    errors = errors_of_levels([white, black], chunk_of(white), "classic")
    np.testing.assert_allclose(errors, [0, 0.75], rtol=1e-4)  # colours are rounded as floats


def test_the_manifest_has_the_errors_of_each_chunk(tmp_path):
    scene = forest(500, seed=5)
    options = st.StreamOptions(chunk_leaves=60, levels=4, errors=True)
    written = st.stream(scene, tmp_path / "out", options=options)
    st.stream(scene, tmp_path / "one", options=options, threads=1)
    manifest = (tmp_path / "out" / "lod-meta.json").read_bytes()
    assert json.loads(manifest)["lodErrors"] is True
    assert manifest == (tmp_path / "one" / "lod-meta.json").read_bytes()
    ranges = open_sog_stream(tmp_path / "out").ranges
    assert ranges.errors.shape == ranges.counts.shape
    assert np.all(ranges.errors[0] == 0) and np.all(np.diff(ranges.errors, axis=0) >= 0)
    assert ranges.errors[-1].max() > 0.01
    report = st.report_stream(scene, written, [CAMERA], budgets=[300])
    assert [view.viewer for view in report.views] == ["playcanvas", "playcanvas 2.22"]


def test_a_stream_without_errors_says_so(tmp_path):
    st.stream(forest(200, seed=5), tmp_path / "out")
    assert json.loads((tmp_path / "out" / "lod-meta.json").read_text())["lodErrors"] is False
    assert open_sog_stream(tmp_path / "out").ranges.errors is None


def ranges_of(places, counts, errors):
    """Chunks that are unit cubes at these depths, all with the same levels."""
    num = len(places)
    boxes = np.array([[[0, 0, z], [1, 1, z + 1]] for z in places], float)
    levels = np.repeat(np.array(counts)[:, None], num, axis=1)
    nothing = np.zeros_like(levels)
    return Ranges(boxes, nothing, nothing, levels, np.repeat(np.array(errors, float)[:, None], num, axis=1))


# The file has 100 rows. A budget of 54 takes lines of 8 rows, of which the last leaves 4 empty, and 50 rows are left.
@pytest.mark.parametrize(
    ("budget", "levels"),
    [(19, [2, 2]), (20, [2, 2]), (53, [2, 2]), (54, [1, 2]), (80, [1, 2]), (211, [0, 1]), (212, [0, 0])],
)
def test_the_nearer_chunk_is_refined_first(budget, levels):
    ranges = ranges_of([0, 40], [100, 40, 10], [0, 0.1, 0.5])
    assert select_by_errors(ranges, CAMERA, budget).tolist() == levels


def test_a_level_that_is_no_better_is_never_bought():
    ranges = ranges_of([0], [100, 40, 10], [0, 0.5, 0.5])
    assert [select_by_errors(ranges, CAMERA, b).tolist() for b in (50, 110)] == [[2], [0]]


def test_a_step_is_worth_the_best_way_on_from_it():
    """The near chunk's first step hardly helps by itself, but the one after it does, and the chunk is nearer."""
    ranges = ranges_of([0, 40], [100, 90, 10], [0, 0.9, 1.0])
    assert select_by_errors(ranges, CAMERA, 110).tolist() == [1, 2]
    assert select_by_errors(ranges, CAMERA, 120).tolist() == [0, 2]


def test_the_first_step_that_does_not_fit_is_the_last():
    """The far chunk's step would fit."""
    ranges = ranges_of([0, 40], [100, 40, 10], [0, 0.1, 0.5])
    counts = ranges.counts.copy()
    counts[:, 1] = [12, 11, 10]
    ranges = dataclasses.replace(ranges, counts=counts, errors=np.stack([[0, 0], [0.1, 0.01], [0.5, 0.012]]))
    assert select_by_errors(ranges, CAMERA, 79).tolist() == [1, 2]


def test_steps_of_about_the_same_worth_are_taken_in_turn():
    """The far chunk's is worth a tenth less, which is one class: it stands first in the list, so it is taken first."""
    ranges = ranges_of([0.05, 0], [100, 40, 10], [0, 0.1, 0.5])
    assert select_by_errors(ranges, CAMERA, 54).tolist() == [1, 2]
    ranges = ranges_of([3.0, 0], [100, 40, 10], [0, 0.1, 0.5])
    assert select_by_errors(ranges, CAMERA, 54).tolist() == [2, 1]
