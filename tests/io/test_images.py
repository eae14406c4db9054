import numpy as np
import pytest
from PIL import Image

import splatree
from splatree import FormatError, InputError, OutputError, ShapeError


def test_png_round_trip_is_exact_for_bytes(tmp_path):
    bytes_ = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    image = bytes_.astype(np.float32) / np.float32(255)
    splatree.write_image(image, tmp_path / "a.png")
    np.testing.assert_array_equal(splatree.read_image(tmp_path / "a.png"), image)


def test_values_are_clipped_and_rounded(tmp_path):
    image = np.array([[-1, 0.5 / 255 - 1e-4, 0.5 / 255 + 1e-4, 2, np.inf]], np.float32)
    splatree.write_image(image, tmp_path / "grey.png")
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "grey.png"))[0], [0, 0, 1, 255, 255])


def test_alpha_is_blended_over_black_and_sizes_are_averaged(tmp_path):
    pixels = np.zeros((2, 4, 4), np.uint8)
    pixels[:, :2] = (255, 255, 255, 51)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    image = splatree.read_image(tmp_path / "a.png")
    np.testing.assert_allclose(image[:, :2], 0.2, atol=1 / 255)
    np.testing.assert_array_equal(image[:, 2:], 0)
    small = splatree.read_image(tmp_path / "a.png", size=(1, 1))
    np.testing.assert_allclose(small, 0.1, atol=1 / 255)


def test_bad_pictures_are_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n damaged")
    with pytest.raises(FormatError, match="not a whole picture"):
        splatree.read_image(tmp_path / "a.png")
    with pytest.raises(InputError, match="not found"):
        splatree.read_image(tmp_path / "gone.png")


def test_what_cannot_be_a_picture_is_refused(tmp_path):
    good = np.zeros((2, 2, 3), np.float32)
    with pytest.raises(InputError, match=r"suffix \.png"):
        splatree.write_image(good, tmp_path / "a.jpg")
    with pytest.raises(ShapeError, match="at least one pixel"):
        splatree.write_image(good[:0], tmp_path / "a.png")
    with pytest.raises(ShapeError, match=r"found shape \(2, 2, 2\)"):
        splatree.write_image(good[..., :2], tmp_path / "a.png")
    with pytest.raises(ShapeError, match="found dtype uint8, wanted floats from 0 to 1; divide bytes by 255"):
        splatree.write_image(good.astype(np.uint8), tmp_path / "a.png")
    with pytest.raises(InputError, match="NaN"):
        splatree.write_image(good * np.nan, tmp_path / "a.png")
    splatree.write_image(good, tmp_path / "a.png")
    with pytest.raises(OutputError, match="exists already"):
        splatree.write_image(good, tmp_path / "a.png")


def test_sixteen_bits_are_rounded_to_eight(tmp_path):
    """Pillow alone would show all that is above 255 of 65,535 as white."""
    grey = np.array([[0, 257, 32896, 65535]], np.uint16)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_allclose(splatree.read_image(tmp_path / "grey.png")[0, :, 1], [0, 1 / 255, 128 / 255, 1])
    Image.fromarray(np.ones((2, 2), np.float32)).save(tmp_path / "float.tif")
    with pytest.raises(FormatError, match=r"float.tif: found 32 bits a pixel"):
        splatree.read_image(tmp_path / "float.tif")


def test_grey_pictures_have_three_equal_channels(tmp_path):
    Image.fromarray(np.array([[7, 200]], np.uint8)).save(tmp_path / "grey.png")
    image = splatree.read_image(tmp_path / "grey.png")
    assert image.shape == (1, 2, 3) and (image == image[..., :1]).all()
