"""Cameras of other programs: read where that can be, else refused by name with a way out."""

import json
import struct

import numpy as np
import pytest
from PIL import Image

import splatree as st
from splatree import Camera, FormatError, InputError
from splatree.io.cameras.poses import Rotations
from splatree.io.cameras.split import split_views
from splatree.render.overlap import overlap_hint

VIEW = Camera.look_at(np.array([3.0, -2.0, 1.0]), np.array([0.1, 0.2, 0.3]), width=640, height=480)
OTHER = Camera.look_at(np.array([-4.0, 0.5, 2.0]), np.zeros(3), width=640, height=480)


def opengl(camera):
    """Camera-to-world with x right, y up, z back."""
    return np.linalg.inv(camera.camera_from_world) @ np.diag([1.0, -1, -1, 1])


def same_view(a, b, atol=1e-9):
    np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=atol)
    np.testing.assert_allclose(a.K, b.K, rtol=1e-9)
    assert (a.width, a.height) == (b.width, b.height)


@pytest.mark.parametrize("flat", [True, False])
def test_a_camera_path_of_nerfstudio(tmp_path, flat):
    frames = [
        {"camera_to_world": opengl(c).ravel().tolist() if flat else opengl(c).tolist(), "fov": 50, "aspect": 1.33}
        for c in (VIEW, OTHER)
    ]
    content = {
        "camera_type": "perspective",
        "render_width": 640,
        "render_height": 480,
        "camera_path": frames,
        "fps": 24,
    }
    (tmp_path / "camera_path.json").write_text(json.dumps(content))
    for path in (tmp_path, tmp_path / "camera_path.json"):
        cameras = st.read_cameras(path)
        for found, wanted in zip(cameras, (VIEW, OTHER), strict=True):
            same_view(found, wanted)
    (tmp_path / "camera_path.json").write_text(json.dumps(content | {"camera_type": "equirectangular"}))
    with pytest.raises(FormatError, match="camera_type 'equirectangular', wanted 'perspective'"):
        st.read_cameras(tmp_path)


def transforms(folder, views=(VIEW, OTHER), name="transforms.json", **extra):
    frames = [{"file_path": f"{i}.png", "transform_matrix": opengl(c).tolist()} for i, c in enumerate(views)]
    content = {"fl_x": VIEW.K[0, 0], "w": 640, "h": 480, "frames": frames, **extra}
    (folder / name).write_text(json.dumps(content))


APPLIED = np.array(
    [[0.0, 1, 0, 0.5], [1, 0, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]]
)  # as ns-process-data moves COLMAP's poses


def test_cameras_are_moved_into_the_frame_of_a_training_of_nerfstudio(tmp_path):
    """As the dataparser does it: T_auto on the poses of the file, then the scale; T_auto after A is what it writes."""
    auto = np.eye(4)
    auto[:3, :3] = VIEW.camera_from_world[:3, :3]
    auto[:3, 3] = (0.3, -0.2, 0.1)
    transforms(tmp_path, applied_transform=APPLIED[:3].tolist(), applied_scale=2.0)
    record = {"transform": (auto @ APPLIED)[:3].tolist(), "scale": 0.25 * 2.0}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(record))
    cameras = st.read_cameras(tmp_path)
    for found, view in zip(cameras, (VIEW, OTHER), strict=True):
        pose = auto @ opengl(view)
        pose[:3, 3] *= 0.25
        np.testing.assert_allclose(opengl(found), pose, atol=1e-9)
    assert "moved into the frame of the training" in cameras.notes[0]
    with pytest.raises(InputError, match=r"holds no cameras.*beside transforms.json"):
        st.read_cameras(tmp_path / "dataparser_transforms.json")
    (tmp_path / "dataparser_transforms.json").write_text('{"transform": [[1]], "scale": 1}')
    with pytest.raises(FormatError, match="transform: found numbers of shape"):
        st.read_cameras(tmp_path)


@pytest.mark.parametrize(("scale", "applied"), [(0, 1), (1, 0), (-1, 1), (1, -1), (0.5, 1), (1, 0.5)])
def test_scales_of_a_training_are_more_than_0(tmp_path, scale, applied):
    transforms(tmp_path, applied_scale=applied)
    (tmp_path / "dataparser_transforms.json").write_text(
        json.dumps({"transform": np.eye(4)[:3].tolist(), "scale": scale})
    )
    if min(scale, applied) > 0:
        assert len(st.read_cameras(tmp_path)) == 2
    else:
        with pytest.raises(
            FormatError, match=f"found the scales {float(scale)} and {float(applied)}, wanted more than 0"
        ):
            st.read_cameras(tmp_path)


def test_the_files_of_a_synthetic_scene(tmp_path):
    angle = 2 * np.arctan(320 / VIEW.K[0, 0])
    for split, view in (("train", VIEW), ("test", OTHER)):
        (tmp_path / split).mkdir()
        Image.new("RGB", (640, 480)).save(tmp_path / split / "r_0.png")
        frames = [{"file_path": f"./{split}/r_0", "transform_matrix": opengl(view).tolist()}]
        frames += [{"file_path": f"./{split}/r_1", "transform_matrix": opengl(view).tolist()}]  # without its picture
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    cameras = st.read_cameras(tmp_path)
    assert [c.name for c in cameras] == ["./train/r_0", "./train/r_1", "./test/r_0", "./test/r_1"]
    same_view(cameras[0], VIEW)
    same_view(cameras[3], OTHER)
    assert "2 of transforms_train.json, 2 of transforms_test.json" in cameras.notes[-1]
    split = split_views(cameras.views, tmp_path / "transforms_test.json")
    assert [c.name for c in split.held_out] == ["./test/r_0", "./test/r_1"]


def test_poses_bounds_of_llff(tmp_path):
    rows = []
    for view in (VIEW, OTHER):
        right, down, forward = view.camera_from_world[:3, :3]
        size = [480, 640, view.K[0, 0]]
        matrix = np.column_stack([down, right, -forward, view.position, size])
        rows.append([*matrix.ravel(), 0.5, 20.0])
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    assert [c.name for c in st.read_cameras(tmp_path)] == ["view_0000", "view_0001"]
    (tmp_path / "images").mkdir()
    for name in ("b.JPG", "a.png"):
        (tmp_path / "images" / name).write_bytes(b"")
    cameras = st.read_cameras(tmp_path)
    assert [c.name for c in cameras] == ["a.png", "b.JPG"]
    for found, wanted in zip(cameras, (VIEW, OTHER), strict=True):
        same_view(found, wanted)
    np.save(tmp_path / "poses_bounds.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(FormatError, match="no array of numbers"):
        st.read_cameras(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 15)))
    with pytest.raises(FormatError, match=r"wanted numbers of shape \(views, 17\)"):
        st.read_cameras(tmp_path)


def llff_row(height, width, focal=50.0):
    matrix = np.column_stack([*(-np.eye(3)[i] for i in (1, 0, 2)), np.zeros(3), [height, width, focal]])
    return [*matrix.ravel(), 0.5, 20.0]


def test_pictures_that_do_not_fit_views_of_llff_are_noted(tmp_path):
    np.save(tmp_path / "poses_bounds.npy", np.array([llff_row(4, 6), llff_row(4, 6)]))
    assert st.read_cameras(tmp_path).notes == ()  # no folder of pictures says nothing
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.png").write_bytes(b"")
    cameras = st.read_cameras(tmp_path)
    assert [c.name for c in cameras] == ["view_0000", "view_0001"]
    assert len(cameras.notes) == 1 and "has 2 views and" in cameras.notes[0] and "1 pictures" in cameras.notes[0]


@pytest.mark.parametrize("size", [(0.9, 6), (4, 0.9), (2**31, 6), (4, 2**31), (-4, 6)])
def test_sizes_that_no_picture_has_are_refused_in_llff(tmp_path, size):
    np.save(tmp_path / "poses_bounds.npy", np.array([llff_row(*size)]))
    with pytest.raises(FormatError, match="row 0: found the size"):
        st.read_cameras(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.array([llff_row(1, 1), llff_row(2**31 - 1, 2**31 - 1)]))
    assert [(c.height, c.width) for c in st.read_cameras(tmp_path)] == [(1, 1), (2**31 - 1, 2**31 - 1)]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cameras.xml", '<?xml version="1.0"?><document version="2.0.0"><chunk label="a">', "Metashape.*COLMAP"),
        ("block.xml", "<BlocksExchange><Block>", "ContextCapture"),
        ("poses.csv", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1\na.jpg,1,2,3", "RealityCapture.*COLMAP"),
        ("reconstruction.json", '[{"cameras": {}, "shots": {}}]', "OpenSfM.*export_colmap"),
        ("123.json", json.dumps({f"t_{r}{c}": 0 for r in range(3) for c in range(4)}), "Polycam.*ns-process-data"),
        ("cameras.sfm", '{"views": [], "poses": []}', "Meshroom or OpenMVG"),
        ("bundle.out", "# Bundle file v0.3\n", "Bundler"),
        ("model.nvm", "NVM_V3\n", "VisualSFM"),
        ("model.nvm", "", "VisualSFM"),
        ("model.txt", "NVM_V3\n", "VisualSFM"),
        ("markers.xml", '<?xml version="1.0"?>' + 4000 * " " + "<!-- Agisoft -->", "Metashape"),
        ("poses.csv", "#name,x,y,heading\n", "RealityCapture"),
        ("poses.csv", "#name,x,y,alt\n", "RealityCapture"),
        ("a.json", '{"views": [], "intrinsics": []}', "Meshroom or OpenMVG"),
        ("metadata.json", '{"poses": [], "K": []}', "Record3D"),
    ],
)
def test_other_cameras_are_refused_by_name_with_advice(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        st.read_cameras(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xml", "<svg>"),
        ("a.csv", "name,x,y"),
        ("a.out", "# something"),
        ("a.json", '{"views": []}'),
        ("a.json", '{"poses": []}'),
        ("a.json", '{"K": []}'),
        ("a.json", '{"t_00": 1}'),
        ("a.json", '{"cameras": []}'),
    ],
)
def test_what_only_looks_a_little_like_the_cameras_of_a_program_is_not_named_after_it(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    with pytest.raises((InputError, FormatError)) as caught:
        st.read_cameras(tmp_path / name)
    assert not any(
        word in str(caught.value) for word in ("Metashape", "RealityCapture", "Bundler", "OpenMVG", "Record3D")
    )
    assert not any(word in str(caught.value) for word in ("Polycam", "OpenSfM", "VisualSFM", "ContextCapture"))


@pytest.mark.parametrize(("name", "message"), [("keyframes/a", "Polycam"), ("reconstruction.json", "OpenSfM")])
def test_folders_of_other_programs_are_refused_by_name(tmp_path, name, message):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("[]")
    with pytest.raises(InputError, match=message):
        st.read_cameras(tmp_path)


def test_cameras_that_do_not_see_the_scene_are_told():
    rng = np.random.default_rng(0)
    n = 300
    scene = st.Scene.flat(
        st.Gaussians(
            rng.normal(0, 0.5, (n, 3)).astype(np.float32), np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
            np.full((n, 3), -4, np.float32), np.zeros(n, np.float32), np.zeros((n, 1, 3), np.float32),
        )
    )  # fmt: skip
    away = VIEW.moved(np.array([1000.0, 0, 0]))
    assert overlap_hint(scene, [VIEW]) is None and overlap_hint(scene, [away, VIEW]) is None
    hint = overlap_hint(scene, [away])
    assert (
        "none of the 1 cameras sees the scene" in hint
        and "dataparser_transforms.json" in hint
        and "applied_transform" in hint
    )
    assert overlap_hint(scene, []) is None


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"\xff\xd8\xff\xe0\0\x10JFIF"])
def test_a_photograph_in_the_place_of_cameras_is_told(tmp_path, content):
    (tmp_path / "0000.png").write_bytes(content)
    with pytest.raises(
        InputError, match=r"found a file that is no text; wanted cameras.json, transforms.json, or a folder"
    ):
        st.read_cameras(tmp_path / "0000.png")


def test_a_pose_without_its_last_row(tmp_path):
    frames = [{"file_path": "0.png", "transform_matrix": opengl(VIEW)[:3].tolist()}]
    lens = {"fl_x": VIEW.K[0, 0], "w": 640, "h": 480}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    same_view(st.read_cameras(tmp_path)[0], VIEW)


def near(angle, axis=(0.6, 0.0, 0.8)):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def with_rotation(tmp_path, matrix, kind):
    """A file of one camera at (1, 2, 3) with this camera-to-world matrix."""
    path, pose = tmp_path / f"{kind}.json", np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix, (1, 2, 3)
    if kind == "cameras":
        content = [{"width": 64, "height": 48, "fx": 50, "fy": 50, "position": [1, 2, 3], "rotation": matrix.tolist()}]
    elif kind == "transforms":
        frames = [{"file_path": "a.png", "transform_matrix": pose.tolist()}]
        content = {"w": 64, "h": 48, "fl_x": 50, "frames": frames}
    else:
        frames = [{"camera_to_world": pose.ravel().tolist(), "fov": 50}]
        content = {"render_width": 64, "render_height": 48, "camera_path": frames}
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("kind", ["cameras", "transforms", "camera_path"])
@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda m: m, None),
        (lambda m: 2.5 * m, "1 camera are scaled"),
        (lambda m: m.round(2), "no exact rotations"),
        (lambda m: (0.01 * m).round(4), "scaled"),
    ],
    ids=["exact", "scaled", "rounded", "both"],
)
def test_rotations_that_are_scaled_or_rounded_are_taken(tmp_path, kind, change, note):
    wanted = near(0.7)
    cameras = st.read_cameras(with_rotation(tmp_path, change(wanted), kind))
    found = cameras[0].camera_from_world[:3, :3].T
    flip = np.eye(3) if kind == "cameras" else np.diag([1.0, -1, -1])
    np.testing.assert_allclose(found @ flip, wanted, atol=0.01)  # two digits
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(cameras[0].position, [1, 2, 3], atol=1e-9)
    assert (not cameras.notes) if note is None else note in " ".join(cameras.notes)


@pytest.mark.parametrize("kind", ["cameras", "transforms", "camera_path"])
@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 1, -1]), "mirrors"),
        (np.diag([1.0, 1, 1.2]), "stretches"),
        (np.zeros((3, 3)), "wanted a rotation"),
        (np.eye(3) * 1e200, "wanted a rotation"),
    ],
)
def test_matrices_that_are_no_rotations_are_refused(tmp_path, kind, matrix, message):
    with pytest.raises(FormatError, match=message):
        st.read_cameras(with_rotation(tmp_path, matrix, kind))


def colmap_text(folder, cameras, images):
    folder.mkdir()
    (folder / "cameras.txt").write_text(cameras)
    (folder / "images.txt").write_text(images)
    return folder


@pytest.mark.parametrize("length", [0.01, 1.0, 2.0, 700.0])
def test_quaternions_of_any_length_are_directions(tmp_path, length):
    """As COLMAP reads them."""
    q = " ".join(str(length * v) for v in (0.5, 0.5, 0.5, 0.5))
    images = f"  # a comment that is indented\n1 {q} 0 0 5 1 a.jpg\n\n"
    cameras = st.read_cameras(colmap_text(tmp_path / "m", "1 PINHOLE 64 48 50 50 32 24\n", images))
    np.testing.assert_allclose(cameras[0].camera_from_world[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert bool(cameras.notes) == (length != 1)


@pytest.mark.parametrize(
    ("number", "name", "num_parameters"),
    [
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
        (12, "SIMPLE_DIVISION", 4),
        (13, "DIVISION", 5),
        (16, "EUCM", 6),
        (17, "EQUIRECTANGULAR", 2),
    ],
)
def test_lenses_of_colmap_4_matter_only_where_a_picture_uses_them(tmp_path, number, name, num_parameters):
    (tmp_path / "m").mkdir()
    cameras = struct.pack("<QiiQQ", 2, 1, number, 64, 48) + np.full(num_parameters, 0.1).tobytes()
    cameras += struct.pack("<iiQQ4d", 2, 15, 64, 48, 50, 50, 32, 24)  # FISHEYE
    (tmp_path / "m/cameras.bin").write_bytes(cameras)

    def used(camera):
        image = struct.pack("<Qi7di", 1, 1, 1, 0, 0, 0, 0, 0, 5, camera) + b"a.jpg\0" + struct.pack("<Q", 0)
        (tmp_path / "m/images.bin").write_bytes(image)
        return st.read_cameras(tmp_path / "m")

    lens = used(2)[0].lens
    assert lens is not None and lens.model == "fisheye" and not lens.radial
    with pytest.raises(FormatError, match=f"found camera model '{name}'.*first"):
        used(1)


def test_notes_count_the_rotations_that_were_mended():
    rotations, exact = Rotations(), near(0.7)
    stretched = exact @ np.diag([1.0, 1.001, 1.003])
    for matrix in (exact, 2 * exact, 0.98 * exact, stretched, exact @ np.diag([1.0, 1, 1.01])):
        np.testing.assert_allclose(rotations.of(matrix, "a"), exact, atol=0.01)
    assert rotations.notes == (
        "the matrices of 2 cameras are scaled: their rotations are taken",
        "the matrices of 2 cameras are no exact rotations (off by up to 1 %): the nearest ones are taken",
    )
    rotations = Rotations()
    rotations.of(exact, "a")
    assert rotations.notes == ()
