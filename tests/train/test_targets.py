"""Photographs at whole divisions: exact means, exact intrinsics, decoded once."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.scene.lens import Lens
from splatree.train import targets
from splatree.train.targets import Targets, coarsest_division, divided, finest_division

CAMERA = replace(st.Camera.look_at(np.array([0.0, 0, -4]), np.zeros(3), width=37, height=22), name="a.png")


@pytest.fixture
def folder(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (22, 37, 3), dtype=np.uint8)
    st.write_image(pixels / np.float32(255), tmp_path / "a.png")
    return tmp_path, pixels


@pytest.mark.parametrize("division", [1, 2, 4, 8])
def test_a_pixel_is_the_mean_of_whole_pixels(folder, division):
    root, pixels = folder
    target = Targets(root, [CAMERA]).at(0, division)
    height, width = 22 // division, 37 // division
    blocks = pixels[: height * division, : width * division].reshape(height, division, width, division, 3)
    assert np.abs(target.photo - blocks.mean(axis=(1, 3))).max() <= 0.5 + 1e-9  # rounded to whole numbers once
    assert (target.camera.width, target.camera.height) == (width, height)


def test_a_divided_camera_sees_the_same_directions():
    camera = divided(CAMERA, 4)
    # The corner of the small pixel (3, 2) is the corner of the large one (12, 8).
    small = (np.array([3, 2]) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    large = (np.array([12, 8]) - CAMERA.K[:2, 2]) / np.diag(CAMERA.K)[:2]
    np.testing.assert_allclose(small, large, rtol=1e-14)


def test_photographs_are_decoded_once_while_there_is_room(folder, monkeypatch):
    root, _ = folder
    photographs, decoded = Targets(root, [CAMERA]), []
    pixels = photographs._photos.pixels
    monkeypatch.setattr(photographs._photos, "pixels", lambda name: decoded.append(name) or pixels(name))
    for _ in range(3):
        photographs.at(0, 2)
    assert len(decoded) == 1
    photographs.drop_others(2)
    photographs.at(0, 2)
    assert len(decoded) == 1
    photographs.drop_others(1)
    monkeypatch.setattr(targets, "KEPT_BYTES", 10)
    for _ in range(3):
        photographs.at(0, 2)
    assert len(decoded) == 4


def test_photographs_at_another_division_make_room(folder, monkeypatch):
    root, _ = folder
    photographs = Targets(root, [CAMERA])
    small = photographs.at(0, 2).num_bytes
    large = photographs._decoded(0, 1).num_bytes
    monkeypatch.setattr(targets, "KEPT_BYTES", large)
    assert small > 0 and photographs.at(0, 1) is photographs.at(0, 1)


def test_a_pixel_counts_if_all_count_that_it_is_made_of(folder):
    root, _ = folder
    mask = np.ones((22, 37, 3), np.float32)
    mask[5, 9] = 0
    (root / "masks").mkdir()
    st.write_image(mask, root / "masks" / "a.png")
    target = Targets(root, [CAMERA], masks=root / "masks").at(0, 4)
    assert np.argwhere(~target.mask).tolist() == [[1, 2]]


def test_sizes_follow_from_the_photographs():
    def camera(width, height):
        return CAMERA.resized(width, height)

    assert [finest_division([camera(*size)]) for size in ((800, 600), (1602, 1200), (4000, 3000), (9000, 6000))] == [
        1,
        2,
        4,
        8,
    ]
    assert [coarsest_division([camera(*size)]) for size in ((64, 64), (200, 200), (1602, 1200))] == [1, 2, 8]


def test_damaged_photographs_are_named(folder):
    root, _ = folder
    data = (root / "a.png").read_bytes()
    (root / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(st.FormatError, match=r"a\.png: not a whole picture"):
        Targets(root, [CAMERA]).at(0, 1)


def test_a_lens_is_straightened_photograph_and_mask_alike(tmp_path):
    """A photograph that shows its own row numbers: straightened, each pixel shows the row that its direction came from."""
    lens = Lens("brown", radial=(-0.15,))
    bent = replace(CAMERA.resized(80, 60), lens=lens)
    rows = np.repeat(np.arange(60, dtype=np.float32)[:, None, None] / 255, 80, axis=1)
    st.write_image(np.repeat(rows, 3, axis=2), tmp_path / "a.png")
    (tmp_path / "masks").mkdir()
    mask = np.ones((60, 80, 3), np.float32)
    mask[:10] = 0
    st.write_image(mask, tmp_path / "masks" / "a.png")
    target = Targets(tmp_path, [bent], masks=tmp_path / "masks").at(0, 1)
    camera = target.camera
    assert camera.lens is None and target.photo.shape[:2] == (camera.height, camera.width)
    centre = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
    slopes = (centre - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    row = lens.bent(slopes)[..., 1] * bent.K[1, 1] + bent.K[1, 2] - 0.5
    assert np.abs(target.photo[..., 0] - row).max() <= 0.51  # rounded to whole numbers
    np.testing.assert_array_equal(target.mask, row >= 9.999)


def test_photographs_beyond_all_measure_are_refused(folder, monkeypatch):
    from PIL import Image

    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 37 * 22 // 3)
    with pytest.raises(st.FormatError, match=r"a\.png: not a whole picture \(Image size .* exceeds limit"):
        Targets(folder[0], [CAMERA])
