import numpy as np

from splatree.bench.crops import busiest, calmest


def test_parts_are_where_detail_is_and_where_it_is_not():
    image = np.full((80, 160, 3), 0.5)
    image[:, :60] += 0.002 * np.arange(60)[:, None]  # a gentle slope on the left
    image[40:60, 120:160] = np.random.default_rng(5).uniform(0.2, 0.9, (20, 40, 1))  # leaves on the right
    image[:20] = 0.0  # the sky, which is no part of the scene
    y, x = busiest(image)
    assert (y.start, x.start) == (40, 120)
    y, x = calmest(image)
    assert image[y, x].std() == 0 and image[y, x].min() == 0.5


def test_a_picture_without_anything_has_parts_too():
    black = np.zeros((8, 8, 3))
    assert black[busiest(black)].shape == black[calmest(black)].shape == (2, 2, 3)
