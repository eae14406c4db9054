import pytest

import splatree


def test_a_chunk_of_the_city(data):
    scene = splatree.read(data / "trained/semarang_city/5_9")
    assert len(scene) == 252_828 and scene.gaussians.sh_degree == 3


@pytest.mark.parametrize("level", [2, 3, 4, 5, 6])
def test_levels_of_a_streamed_scene(data, level):
    counts = [500_000, 250_000, 125_000, 31_000, 8_406, 3_000, 1_873]
    scene = splatree.read(data / "trained/playbot", level=level)
    assert len(scene) == counts[level] and scene.gaussians.sh_degree == 2
