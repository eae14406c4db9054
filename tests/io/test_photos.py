"""Which photograph belongs to which camera, and in what shape it is compared."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import splatree as st
from splatree import Camera, InputError
from splatree.io.photos import Photos
from splatree.scene.lens import Lens

SIZE = (24, 16)
VIEW = Camera.look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3), width=SIZE[0], height=SIZE[1])


def cameras(*names, size=SIZE):
    return [replace(VIEW.resized(*size), name=name) for name in names]


def save(path, value, size=SIZE):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (value, value, value)).save(path)


def values(photos):
    """The grey of each photograph, by name."""
    return {name: round(255 * float(photos[name].mean())) for name in photos}


def test_who_asks_whether_there_is_a_photograph_reads_none(tmp_path):
    Image.new("RGB", SIZE).save(tmp_path / "a.jpg")
    photos = Photos(tmp_path, [replace(VIEW, name="a.jpg"), replace(VIEW, name="b.jpg")])
    (tmp_path / "a.jpg").unlink()
    assert "a.jpg" in photos and "b.jpg" not in photos and list(photos) == ["a.jpg"]


def test_masks_beside_the_images_are_no_photographs(tmp_path):
    for i in range(3):
        save(tmp_path / "images" / f"{i}.png", 100 + i)
        save(tmp_path / "masks" / f"{i}.png", 255)
        save(tmp_path / "zzz" / f"{i}.png", 1)
    photos = Photos(tmp_path, cameras("0.png", "1.png", "2.png"))
    assert values(photos) == {"0.png": 100, "1.png": 101, "2.png": 102}
    assert photos.used.folders == {"images": 3} and photos.used.in_words() == ["photographs: 3 in images/"]


def test_folders_of_names_are_never_dropped(tmp_path):
    for i, side in enumerate(("left", "right")):
        save(tmp_path / "images" / side / "0000.png", 100 + i)
    both = cameras("left/0000.png", "right/0000.png")
    assert values(Photos(tmp_path, both)) == {"left/0000.png": 100, "right/0000.png": 101}
    # Of the folder of one side only its own cameras have photographs.
    photos = Photos(tmp_path / "images" / "left", both)
    assert values(photos) == {"left/0000.png": 100} and photos.used.missing == ("right/0000.png",)
    with pytest.raises(InputError, match=r"could be any of 2 files.*images/left/0000.png, images/right/0000.png"):
        Photos(tmp_path, cameras("0000.png"))


@pytest.mark.parametrize("name", ["./train/r_0", "train\\r_0", "train/./r_0", "val/../train/r_0"])
def test_a_file_path_is_relative_to_the_folder_of_its_json(tmp_path, name):
    for i, split in enumerate(("train", "val", "test")):
        save(tmp_path / split / "r_0.png", 100 + i)
    assert values(Photos(tmp_path, cameras(name))) == {name: 100}


def test_a_split_that_is_not_there_is_not_replaced_by_another(tmp_path):
    save(tmp_path / "val" / "r_0.png", 1)
    with pytest.raises(InputError, match=r"none of the 1 pictures.*files of these names lie in val"):
        Photos(tmp_path, cameras("train/r_0"))
    with pytest.raises(InputError, match="none of the 1 pictures"):
        Photos(tmp_path / "val", cameras("train/r_0"))


def test_the_scaled_copy_of_the_cameras_size_comes_first(tmp_path):
    for factor, value in ((1, 100), (2, 101), (4, 102)):
        name = "images" if factor == 1 else f"images_{factor}"
        save(tmp_path / name / "a.JPG", value, (96 // factor, 64 // factor))
    for size, wanted in (((96, 64), 100), ((48, 32), 101), ((24, 16), 102)):
        photos = Photos(tmp_path, cameras("a.JPG", size=size))
        assert abs(values(photos)["a.JPG"] - wanted) <= 1 and photos.views[0].width == size[0] and not photos.used.notes


@pytest.mark.parametrize(
    "name", ["images/a.png", "a.png", "/home/someone/scene/images/a.png", "C:\\scene\\images\\a.png"]
)
def test_a_scaled_copy_alone_makes_the_views_smaller(tmp_path, name):
    save(tmp_path / "images_2" / "a.png", 101, (13, 9))  # half of 25 × 17, rounded up
    photos = Photos(tmp_path, cameras(name, size=(25, 17)))
    (view,) = photos.views
    assert (view.width, view.height) == (13, 9) and photos[name].shape == (9, 13, 3)
    np.testing.assert_allclose(view.K[0, 0] / view.K[0, 2], VIEW.K[0, 0] / VIEW.K[0, 2])
    assert (
        "1 of 1 views: drawn at the size of the photographs, 13 × 9 px; the cameras say 25 × 17 px" in photos.used.notes
    )


def test_larger_photographs_are_averaged_and_said(tmp_path):
    save(tmp_path / "images" / "a.png", 100, (48, 32))
    photos = Photos(tmp_path, cameras("a"))
    assert photos["a"].shape == (16, 24, 3) and "averaged from 48 × 32 px" in photos.used.notes[0]


@pytest.mark.parametrize("size", [(16, 24), (24, 18), (24, 24)])
def test_a_photograph_of_another_shape_is_refused(tmp_path, size):
    save(tmp_path / "images" / "a.png", 100, size)
    with pytest.raises(InputError, match=r"is not the shape of its camera 'a.png', 24 × 16 px; 1 of 1 photographs"):
        Photos(tmp_path, cameras("a.png"))


def test_a_missing_photograph_is_told(tmp_path):
    save(tmp_path / "images" / "b.png", 100)
    photos = Photos(tmp_path, cameras("a.png", "b.png"))
    assert list(photos) == ["b.png"] and photos.used.missing == ("a.png",)
    assert photos.used.in_words()[1] == "no photograph of 1 of 2 cameras: a.png"


def test_thumbnails_of_a_file_server_are_passed_over(tmp_path):
    save(tmp_path / "rgb" / "a.jpg", 100)
    save(tmp_path / "rgb" / "@eaDir" / "a.jpg", 1)
    save(tmp_path / ".thumbnails" / "a.jpg", 2)
    save(tmp_path / "Thumbs" / "a.jpg", 3)
    assert values(Photos(tmp_path, cameras("a.jpg"))) == {"a.jpg": 100}


def test_what_stays_ambiguous_is_refused_with_the_candidates(tmp_path):
    save(tmp_path / "rgb" / "a.png", 100)
    save(tmp_path / "other" / "a.png", 101)
    with pytest.raises(InputError, match=r"could be any of 2 files.*other/a.png, rgb/a.png; name the folder"):
        Photos(tmp_path, cameras("a.png"))
    assert values(Photos(tmp_path / "rgb", cameras("a.png"))) == {"a.png": 100}
    save(tmp_path / "rgb" / "a.jpg", 3)
    with pytest.raises(InputError, match=r"rgb|a\.jpg, a\.png"):
        Photos(tmp_path / "rgb", cameras("a"))


def test_only_masks_is_an_error_that_names_them(tmp_path):
    save(tmp_path / "masks" / "a.png", 255)
    with pytest.raises(InputError, match=r"files of these names lie in masks.*--data"):
        Photos(tmp_path, cameras("a.png"))
    assert len(Photos(tmp_path / "masks", cameras("a.png"))) == 1  # named, so meant


def test_links_are_followed_and_loops_end(tmp_path):
    save(tmp_path / "elsewhere" / "a.png", 100)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "pictures").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "data" / "loop").symlink_to(tmp_path / "data")
    assert values(Photos(tmp_path / "data", cameras("a.png"))) == {"a.png": 100}
    (tmp_path / "data" / "images").symlink_to(tmp_path / "elsewhere")
    assert Photos(tmp_path / "data", cameras("a.png")).used.folders == {"images": 1}


def test_cameras_of_one_name_are_refused(tmp_path):
    save(tmp_path / "a.png", 100)
    with pytest.raises(InputError, match=r"several cameras named 'a\.png'"):
        Photos(tmp_path, cameras("a.png", "a.png"))


def test_other_suffixes_cases_and_codings_of_a_name_are_found(tmp_path):
    save(tmp_path / "images" / "DSC_1.jpg", 100)
    save(tmp_path / "images" / "Gru\u0308n.png", 101)  # as macOS decomposes it
    found = Photos(tmp_path, cameras("DSC_1.JPG", "Gr\u00fcn.png"))
    assert set(found) == {"DSC_1.JPG", "Gr\u00fcn.png"}


def test_photographs_through_a_lens_are_straightened(tmp_path):
    rng = np.random.default_rng(0)
    means = (rng.uniform(-2, 2, (80, 3)) * (1, 1, 0.2)).astype(np.float32)
    scene = st.Scene.flat(
        st.Gaussians(
            means, np.tile(np.float32([1, 0, 0, 0]), (80, 1)), np.full((80, 3), -1.5, np.float32),
            np.full(80, 1.0, np.float32), rng.standard_normal((80, 1, 3)).astype(np.float32),
        )
    )  # fmt: skip
    camera = replace(VIEW.resized(120, 80), lens=Lens("brown", (-0.25, 0.05)), name="a.png")
    (tmp_path / "images").mkdir()
    st.write_image(st.render(scene, camera).image, tmp_path / "images" / "a.png")
    photos = Photos(tmp_path, [camera])
    (view,) = photos.views
    assert view.lens is None and "straightened by the lens" in photos.used.notes[0]
    drawn = np.clip(st.render(scene, view).image, 0, 1)
    assert st.psnr(drawn, photos["a.png"]) > 38
    bent = np.clip(st.render(scene, replace(camera, lens=None)).image, 0, 1)
    assert st.psnr(bent, st.read_image(tmp_path / "images" / "a.png")) < 30  # what ignoring the lens would give
    half = view.scaled(0.5)
    assert photos.at([half])["a.png"].shape == (half.height, half.width, 3)


CORNERS = np.array([[30, 90], [150, 210]])
"""Greys of the corners of an upright picture, row by row."""

STORED = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a),  # shown after a quarter turn clockwise
    7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
    8: lambda a: np.rot90(a, -1),
}
"""How a picture is stored that is shown upright by each orientation (CIPA DC-008, table of the tag Orientation)."""


def save_turned(path, orientation, upright=(48, 32)):
    """A JPEG as a phone writes it: stored in some way, with the tag that makes it upright."""
    width, height = upright
    pixels = np.kron(CORNERS, np.ones((height // 2, width // 2))).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(STORED[orientation](pixels))).convert("RGB")
    exif = Image.Exif()
    exif[0x0112] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, exif=exif, quality=95)


def corners(photo):
    h, w = photo.shape[:2]
    at = [[photo[y, x, 0] for x in (w // 4, -w // 4)] for y in (h // 4, -h // 4)]
    return np.round(255 * np.array(at))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_turned_by_its_orientation_if_asked(tmp_path, orientation):
    save_turned(tmp_path / "a.jpg", orientation)
    upright = st.read_image(tmp_path / "a.jpg", turned=True)
    assert upright.shape == (32, 48, 3) and np.abs(corners(upright) - CORNERS).max() <= 3
    stored = st.read_image(tmp_path / "a.jpg")
    assert np.abs(corners(stored) - STORED[orientation](CORNERS)).max() <= 3


@pytest.mark.parametrize("orientation", range(5, 9))
def test_a_photograph_is_turned_if_only_so_it_fits_its_camera(tmp_path, orientation):
    save_turned(tmp_path / "a.jpg", orientation)
    seen = Photos(tmp_path, cameras("a.jpg", size=(48, 32)))  # its maker turned it
    assert np.abs(corners(seen["a.jpg"]) - CORNERS).max() <= 3
    assert seen.used.notes == ("1 of 1 views: turned as their EXIF orientation says, as their cameras saw them",)
    stored = Photos(tmp_path, cameras("a.jpg", size=(32, 48)))  # COLMAP's camera
    assert np.abs(corners(stored["a.jpg"]) - STORED[orientation](CORNERS)).max() <= 3
    assert "taken as stored" in stored.used.notes[0]
    with pytest.raises(InputError, match="neither turned nor cropped"):
        Photos(tmp_path, cameras("a.jpg", size=(48, 20)))


@pytest.mark.parametrize("orientation", [2, 3, 4])
def test_half_turns_follow_the_photographs_whose_shape_says_something(tmp_path, orientation):
    """Such a tag does not change the shape: COLMAP's way, unless the others of the set show that their maker turned them."""
    save_turned(tmp_path / "half.jpg", orientation)
    alone = Photos(tmp_path, cameras("half.jpg", size=(48, 32)))
    assert np.abs(corners(alone["half.jpg"]) - STORED[orientation](CORNERS)).max() <= 3
    save_turned(tmp_path / "quarter.jpg", 6, upright=(32, 48))
    turned = [*cameras("half.jpg", size=(48, 32)), *cameras("quarter.jpg", size=(32, 48))]
    photos = Photos(tmp_path, turned)
    assert all(np.abs(corners(photos[name]) - CORNERS).max() <= 3 for name in photos)
    stored = [*cameras("half.jpg", size=(48, 32)), *cameras("quarter.jpg", size=(48, 32))]
    photos = Photos(tmp_path, stored)
    assert np.abs(corners(photos["half.jpg"]) - STORED[orientation](CORNERS)).max() <= 3
    assert photos.used.notes[0].startswith("2 of 2 views: taken as stored")


def test_a_damaged_exif_is_no_orientation(tmp_path):
    Image.new("RGB", SIZE, (7, 7, 7)).save(tmp_path / "a.jpg", exif=b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03")
    with pytest.warns(UserWarning, match="Corrupt EXIF"):  # Pillow's
        assert values(Photos(tmp_path, cameras("a.jpg"))) == {"a.jpg": 7}


def test_two_places_that_fit_equally_well_are_not_guessed_between(tmp_path):
    save(tmp_path / "0.png", 100)
    save(tmp_path / "images" / "0.png", 101)
    with pytest.raises(InputError, match=r"'0.png' could be any of 2 files.*0.png, images/0.png"):
        Photos(tmp_path, cameras("0.png"))
    save(tmp_path / "images" / "0.png", 100)  # equal files are one photograph
    assert values(Photos(tmp_path, cameras("0.png"))) == {"0.png": 100}


def test_of_copies_at_other_scales_than_the_cameras_the_largest_is_taken(tmp_path):
    save(tmp_path / "images_2" / "0.png", 102, size=(12, 8))
    save(tmp_path / "images_4" / "0.png", 104, size=(6, 4))
    assert values(Photos(tmp_path, cameras("images/0.png"))) == {"images/0.png": 102}


def test_only_folders_named_like_it_are_scaled_copies(tmp_path):
    save(tmp_path / "photos_2" / "0.png", 100, size=(12, 8))
    save(tmp_path / "images_4" / "0.png", 104, size=(6, 4))
    assert Photos(tmp_path, cameras("images/0.png")).used.folders == {"images_4": 1}


def test_a_folder_of_a_relative_name_is_not_lost_unless_it_is_a_plain_one(tmp_path):
    save(tmp_path / "0.png", 100)
    with pytest.raises(InputError, match="files of these names lie in"):
        Photos(tmp_path, cameras("street/0.png"))
    for name in ("images/0.png", "C:\\scans\\street\\0.png", "/home/me/street/0.png"):
        assert values(Photos(tmp_path, cameras(name))) == {name: 100}


def test_a_folder_without_pictures_is_told(tmp_path):
    camera = Camera.look_at([0, 0, -5], [0, 0, 0], width=8, height=8)
    with pytest.raises(InputError, match=r"data: found no pictures in .*, wanted those of the 1 cameras"):
        Photos(tmp_path, [replace(camera, name="a.png")])
