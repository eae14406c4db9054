"""Where training starts: σ from neighbours, and something in every cell of every photograph."""

import numpy as np
import pytest

from splatree.errors import InputError
from splatree.io.cameras.points import Points
from splatree.maths.harmonics import basis_from_directions
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.train.start import APRON_CELLS, add_apron, extent_of, fill_empty_cells, neighbour_distances, start_from

from .conftest import views


def points_of(places, num_pictures=0):
    n = len(places)
    return Points(places, np.full((n, 3), 200, np.uint8), np.full(n, num_pictures, np.int32))


@pytest.mark.parametrize("kind", ["ball", "plane", "line"])
def test_distances_are_those_of_the_three_nearest(kind):
    rng = np.random.default_rng(0)
    places = rng.normal(size=(3000, 3)) * {"ball": (1, 1, 1), "plane": (1, 1, 0), "line": (1, 0, 0)}[kind]
    squared = np.sort(((places[:200, None] - places) ** 2).sum(axis=2), axis=1)[:, 1:4]
    ratio = neighbour_distances(places)[:200] / np.sqrt(squared.mean(axis=1))
    assert ratio.min() > 1 - 1e-9  # what is found is never nearer than what is nearest
    assert (ratio < 1.1).mean() > 0.9  # measured: 94 to 96 % on two real sets


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_few_points_have_distances_too(n):
    found = neighbour_distances(np.arange(3.0 * n).reshape(n, 3))
    assert np.isfinite(found).all() and (found > 0).all()


def test_points_become_spheres_of_their_colour():
    places = np.random.default_rng(0).random((500, 3))
    start = start_from(points_of(places), degree=1, max_gaussians=1000, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(start.means, places.astype(np.float32))
    color = 0.5 + basis_from_directions(np.array([[0.0, 0, 1]]), 0)[0, 0] * start.sh[:, 0]
    np.testing.assert_allclose(color, 200 / 255, rtol=1e-5)
    sigma = start.scales()
    assert (sigma == sigma[:, :1]).all()
    mean = neighbour_distances(places).mean()
    assert sigma.min() >= mean / 6 * 0.999 and sigma.max() <= 4 * mean * 1.001


def test_points_that_few_pictures_show_are_left_out_where_files_say_it():
    places = np.random.default_rng(0).random((100, 3))
    mixed = Points(places, np.zeros((100, 3), np.uint8), np.arange(100, dtype=np.int32) % 5)
    rng = np.random.default_rng(0)
    assert len(start_from(mixed, degree=0, max_gaussians=1000, rng=rng)) == 40
    assert len(start_from(points_of(places), degree=0, max_gaussians=1000, rng=rng)) == 100
    assert len(start_from(points_of(places, 2), degree=0, max_gaussians=1000, rng=rng)) == 100  # all are weak
    assert len(start_from(points_of(places), degree=0, max_gaussians=30, rng=rng)) == 30


def test_every_cell_of_every_view_gets_something():
    """Points in one corner only: afterwards each sixteenth of each photograph has a Gaussian of the photograph's colour."""
    cameras = views(3)
    places = np.random.default_rng(0).normal(0, 0.1, (300, 3))
    start = start_from(points_of(places), degree=0, max_gaussians=10**4, rng=np.random.default_rng(0))
    photo = np.zeros((32, 32, 3), np.uint8)  # at half of the size
    photo[:, :16, 0] = 255
    filled = fill_empty_cells(start, cameras, lambda i: photo, room=10**4)
    for i, camera in enumerate(cameras):
        seen = filled.means @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        cells = np.floor((seen[:, :2] / seen[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]) / 4).astype(int)
        inside = cells[(cells >= 0).all(axis=1) & (cells < 16).all(axis=1)]
        assert len(np.unique(inside, axis=0)) == 256
        if i == 0:
            own = slice(300, None)
            left = cells[own, 0] < 8
            first = (cells[own] >= 0).all(axis=1) & (cells[own] < 16).all(axis=1)
            red = filled.sh[own, 0, 0] > 0
            assert (red == left)[first][:200].all()
    assert (np.abs(filled.means).max(axis=1) < 10).all()
    assert len(fill_empty_cells(start, cameras, lambda i: photo, room=7)) == 307
    assert isinstance(filled, Gaussians)


def plane_of(color):
    """Points of a plane that the view fills: a cell of 4 px of 64 is 4 / 64 of its width."""
    across = np.linspace(-1.3, 1.3, 60)
    x, y = (grid.ravel() for grid in np.meshgrid(across, across))
    points = Points(np.stack([x, y, 0 * x], axis=1), np.full((x.size, 3), color, np.uint8), np.zeros(x.size, np.int32))
    return start_from(points, degree=1, max_gaussians=10**4, rng=np.random.default_rng(0))


def facing(x=0.0):
    """A view of 64 px, three units before the plane z = 0."""
    return Camera.look_at(np.array([x, 0, -3.0]), np.array([x, 0, 0.0]), width=64, height=64, fov_y_deg=45)


def pixels_of(places, camera):
    seen = places @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    return seen[:, :2] / seen[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]


def test_beyond_the_border_lies_the_colour_of_the_border():
    camera, start = facing(), plane_of(200)
    photo = np.zeros((32, 32, 3), np.uint8)  # at half of the size: red at its left, blue at its right
    photo[:, :16, 0], photo[:, 16:, 2] = 255, 255
    apron = add_apron(start, [camera], lambda i: photo, room=10**4).take(slice(len(start), None))
    assert len(apron) == (16 + 2 * APRON_CELLS) ** 2 - 16**2 - inner_cells(start, camera)
    pixel = pixels_of(apron.means.astype(np.float64), camera)
    assert ((pixel < 0) | (pixel >= 64)).any(axis=1).all()
    np.testing.assert_allclose(apron.means[:, 2], 0, atol=1e-5)  # the plane goes on
    np.testing.assert_array_equal(apron.sh[:, 0, 0] > 0, pixel[:, 0] < 32)
    np.testing.assert_array_equal(apron.sh[:, 0, 2] > 0, pixel[:, 0] >= 32)


def test_photographs_with_fewer_pixels_than_cells_have_the_colours_of_their_pixels():
    """Of 16 cells across, whose sums would be divided by no pixel."""
    camera, start = facing(), plane_of(200)
    photo = np.zeros((3, 2, 3), np.uint8)
    photo[:, 0, 0], photo[:, 1, 2] = 255, 255
    apron = add_apron(start, [camera], lambda i: photo, room=10**4).take(slice(len(start), None))
    pixel = pixels_of(apron.means.astype(np.float64), camera)
    np.testing.assert_array_equal(apron.sh[:, 0, 0] > 0, pixel[:, 0] < 32)
    np.testing.assert_array_equal(apron.sh[:, 0, 2] > 0, pixel[:, 0] >= 32)


def inner_cells(gaussians, camera):
    """Cells beyond the picture in which points lie."""
    cells = np.unique(np.floor(pixels_of(gaussians.means.astype(np.float64), camera) / 4).astype(int), axis=0)
    return int(((cells < 0) | (cells >= 16)).any(axis=1).sum())


def test_a_slanted_plane_goes_on_and_a_heap_does_not():
    camera, plane = facing(), plane_of(200)
    plane.means[:, :2] *= 1.2
    plane.means[:, 2] = 0.5 * plane.means[:, 0]
    pixel = pixels_of(plane.means.astype(np.float64), camera)
    plane = plane.take(((pixel >= 0) & (pixel < 64)).all(axis=1))
    photo = np.full((64, 64, 3), 90, np.uint8)
    apron = add_apron(plane, [camera], lambda i: photo, room=10**4).means[len(plane) :]
    assert len(apron) > 200
    # A cell has the median depth of its points, not the depth of its middle: a tenth of a cell's width of 0.2 units, and more
    # where four cells beyond the border are reached by a slope.
    assert np.abs(apron[:, 2] - 0.5 * apron[:, 0]).max() < 0.2
    heap = plane.take(slice(None))
    heap.means[:] += np.random.default_rng(0).normal(0, 0.5, heap.means.shape).astype(np.float32)
    assert len(add_apron(heap, [camera], lambda i: photo, room=10**4)) - len(heap) < 0.1 * len(apron)


def test_no_view_shows_the_middle_of_what_lies_beyond_the_borders():
    cameras, start = [facing(x) for x in (-0.7, 0, 0.7)], plane_of(200)
    apron = add_apron(start, cameras, lambda i: np.full((64, 64, 3), 90, np.uint8), room=10**4)
    new = apron.means[len(start) :].astype(np.float64)
    assert len(new) > 100
    for camera in cameras:
        pixel = pixels_of(new, camera)
        assert ((pixel < 0) | (pixel >= 64)).any(axis=1).all()
    assert len(add_apron(start, cameras, lambda i: np.full((64, 64, 3), 90, np.uint8), room=7)) == len(start) + 7
    assert len(add_apron(start, cameras, lambda i: np.full((64, 64, 3), 90, np.uint8), room=0)) == len(start)


def test_nothing_is_put_before_what_another_view_has():
    """A floor goes on beyond the border of its view, but not where another view, along the floor, has a wall behind it."""
    floor, wall = plane_of(200), plane_of(200)
    floor.means[:] = floor.means * 0.35 + np.float32([0, 0, -2])
    wall.means[:] = np.stack([np.full(len(wall), -8.0), wall.means[:, 0], wall.means[:, 1] + 0.4], axis=1)
    along = Camera.look_at(np.array([6.0, 0, -3.8]), np.array([0, 0, -2.0]), width=64, height=64, fov_y_deg=5)
    cameras = [facing(), along]

    def beside_the_view_along(gaussians):
        found = add_apron(gaussians, cameras, lambda i: np.full((64, 64, 3), 90, np.uint8), room=10**4)
        new = found.means[len(gaussians) :].astype(np.float64)
        row = pixels_of(new, along)[:, 1]
        beside = ((row > -15) & (row < 0)) | ((row >= 64) & (row < 79))  # within four cells of its picture
        return int((beside & (abs(new[:, 2] + 2) < 1e-4) & (abs(new[:, 0]) > 0.55) & (abs(new[:, 0]) < 1)).sum())

    assert beside_the_view_along(floor) > 4
    assert beside_the_view_along(Gaussians.concatenate([floor, wall])) == 0


def test_one_place_has_no_extent():
    camera = views(1)[0]
    with pytest.raises(InputError, match="at one place"):
        extent_of([camera, camera])
    assert extent_of(views(4)) > 0.5
