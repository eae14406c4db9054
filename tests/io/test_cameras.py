import json
import struct

import numpy as np
import pytest

import splatree
from splatree import Camera, Cameras, FormatError, InputError, OutputError
from splatree.scene.lens import Lens

POSES = [
    Camera.look_at(np.array(position), np.array([0.1, 0.2, 0.3]), width=640, height=480)
    for position in ([3.0, -2.0, 1.0], [-4.0, 0.5, 2.0], [0.0, -5.0, 0.1])
]


def quaternion(rotation):
    """wxyz of a rotation, by the eigenvector of the largest eigenvalue (Bar-Itzhack 2000), not by the code under test."""
    m = rotation
    K = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    return np.linalg.eigh(K)[1][:, -1]


def write_colmap(folder, *, binary, model="PINHOLE", parameters=(600.0, 610.0, 320.0, 240.0), poses=POSES):
    folder.mkdir(parents=True)
    names = ["b view.jpg", "a.jpg", "c.jpg"]
    models = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FOV": 7}
    poses = [(*quaternion(c.camera_from_world[:3, :3]), *c.camera_from_world[:3, 3]) for c in poses]
    if binary:
        cameras = struct.pack("<QiiQQ", 1, 7, models[model], 640, 480) + struct.pack(
            f"<{len(parameters)}d", *parameters
        )
        images = struct.pack("<Q", len(poses))
        for i, (name, pose) in enumerate(zip(names, poses, strict=False)):
            points = struct.pack("<ddq", 1.0, 2.0, -1) * i
            images += struct.pack("<i7di", i + 1, *pose, 7) + name.encode() + b"\0" + struct.pack("<Q", i) + points
        (folder / "cameras.bin").write_bytes(cameras)
        (folder / "images.bin").write_bytes(images)
    else:
        numbers = " ".join(map(str, parameters))
        (folder / "cameras.txt").write_text(f"# Camera list\n# Number of cameras: 1\n7 {model} 640 480 {numbers}\n")
        lines = ["# Image list"]
        for i, (name, pose) in enumerate(zip(names, poses, strict=False)):
            lines += [f"{i + 1} {' '.join(map(repr, map(float, pose)))} 7 {name}", "1.0 2.0 -1 " * i]
        (folder / "images.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("place", ["", "sparse/0", "sparse", "colmap/sparse/0"])
def test_colmap_poses_are_world_to_camera_by_the_name_of_the_picture(tmp_path, binary, place):
    write_colmap(tmp_path / "scene" / place, binary=binary)
    cameras = splatree.read_cameras(tmp_path / "scene")
    assert [c.name for c in cameras] == ["a.jpg", "b view.jpg", "c.jpg"]
    for camera, wanted in zip(cameras, (POSES[1], POSES[0], POSES[2]), strict=True):
        np.testing.assert_allclose(camera.camera_from_world, wanted.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(camera.K, [[600, 0, 320], [0, 610, 240], [0, 0, 1]])
        assert (camera.width, camera.height) == (640, 480)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize(
    ("model", "parameters", "lens"),
    [
        ("SIMPLE_PINHOLE", (600.0, 320.0, 240.0), None),
        ("SIMPLE_RADIAL", (600.0, 320.0, 240.0, 0.0), None),
        ("OPENCV", (600.0, 600.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0), None),
        ("FOV", (600.0, 600.0, 320.0, 240.0, 0.0), None),
        ("SIMPLE_RADIAL", (600.0, 320.0, 240.0, -0.1), Lens("brown", (-0.1,))),
        ("OPENCV", (600.0, 600.0, 320.0, 240.0, 0.1, 0.0, 0.0, 1e-3), Lens("brown", (0.1,), tangential=(0.0, 1e-3))),
        ("OPENCV_FISHEYE", (600.0, 600.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0), Lens("fisheye")),
        ("FOV", (600.0, 600.0, 320.0, 240.0, 0.9), Lens("fov", (0.9,))),
    ],
)
def test_colmap_models_become_pinholes_or_lenses(tmp_path, binary, model, parameters, lens):
    write_colmap(tmp_path / "m", binary=binary, model=model, parameters=parameters)
    camera = splatree.read_cameras(tmp_path / "m")[0]
    assert camera.K[1, 1] == 600 and camera.lens == lens


@pytest.mark.parametrize("binary", [True, False])
def test_parameters_that_are_no_numbers_are_refused(tmp_path, binary):
    write_colmap(tmp_path / "m", binary=binary, parameters=(float("nan"), 600.0, 320.0, 240.0))
    with pytest.raises(FormatError, match="NaN"):
        splatree.read_cameras(tmp_path / "m")


def test_a_camera_that_no_picture_uses_blocks_nothing(tmp_path):
    folder = write_colmap(tmp_path / "m", binary=False)
    with (folder / "cameras.txt").open("a") as file:
        file.write("8 SIMPLE_RADIAL 640 480 500 320\n9 FANCY_LENS 640 480 1 2 3\n")
    assert len(splatree.read_cameras(folder)) == 3


def test_of_several_models_the_largest_is_taken_and_said(tmp_path):
    write_colmap(tmp_path / "sparse" / "0", binary=False, poses=POSES[:1])
    write_colmap(tmp_path / "sparse" / "1", binary=True)
    cameras = splatree.read_cameras(tmp_path)
    assert len(cameras) == 3 and "holds 2 COLMAP models (pictures by number: 1: 3, 0: 1)" in cameras.notes[0]
    assert (
        len(splatree.read_cameras(tmp_path / "sparse" / "0")) == 1
        and len(splatree.read_cameras(tmp_path / "sparse")) == 3
    )


def test_colmap_text_without_blank_lines_loses_no_picture(tmp_path):
    folder = write_colmap(tmp_path / "m", binary=False)
    lines = (folder / "images.txt").read_text().split("\n")
    (folder / "images.txt").write_text("\n".join(line for line in lines if line.strip()))
    assert [c.name for c in splatree.read_cameras(folder)] == ["a.jpg", "b view.jpg", "c.jpg"]


def test_text_with_a_byte_order_mark_is_read(tmp_path):
    folder = write_colmap(tmp_path / "m", binary=False)
    wanted = [view.name for view in splatree.read_cameras(folder)]
    for name in ("cameras.txt", "images.txt"):
        lines = [line for line in (folder / name).read_text().split("\n") if not line.startswith("#")]
        (folder / name).write_text("\n".join(lines), encoding="utf-8-sig")
    assert [view.name for view in splatree.read_cameras(folder)] == wanted


@pytest.mark.parametrize(("gone", "left"), [("cameras", "images"), ("images", "cameras")])
@pytest.mark.parametrize("binary", [True, False])
def test_half_a_model_is_named(tmp_path, gone, left, binary):
    folder, suffix = write_colmap(tmp_path / "sparse" / "0", binary=binary), ".bin" if binary else ".txt"
    (folder / f"{gone}{suffix}").unlink()
    with pytest.raises(InputError, match=rf"{left}\{suffix} without {gone}\{suffix} beside it, wanted both"):
        splatree.read_cameras(tmp_path)


@pytest.mark.parametrize("binary", [True, False])
def test_names_in_latin_1_are_read(tmp_path, binary):
    folder = write_colmap(tmp_path / "m", binary=binary)
    file = folder / ("images.bin" if binary else "images.txt")
    file.write_bytes(file.read_bytes().replace(b"a.jpg", "ä.jpg".encode("latin-1")))
    assert "ä.jpg" in [c.name for c in splatree.read_cameras(folder)]


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_cut_off_colmap_files_are_refused(tmp_path, name):
    write_colmap(tmp_path / "m", binary=True)
    whole = (tmp_path / "m" / name).read_bytes()
    for length in range(0, len(whole), 7):
        (tmp_path / "m" / name).write_bytes(whole[:length])
        with pytest.raises(FormatError, match=f"{name}: found .*cut off"):
            splatree.read_cameras(tmp_path / "m")


@pytest.mark.parametrize("value", [1e300, float("inf"), float("nan")])
@pytest.mark.parametrize("place", range(7))
def test_absurd_poses_are_refused_or_valid(tmp_path, value, place):
    write_colmap(tmp_path / "m", binary=True)
    data = bytearray((tmp_path / "m/images.bin").read_bytes())
    struct.pack_into("<d", data, 12 + 8 * place, value)
    (tmp_path / "m/images.bin").write_bytes(data)
    if value == 1e300 and place > 3:  # far away, but a pose
        assert len(splatree.read_cameras(tmp_path / "m")) == 3
    else:
        with pytest.raises(FormatError, match="quaternion"):
            splatree.read_cameras(tmp_path / "m")


def test_a_lying_count_ends_with_the_file(tmp_path):
    write_colmap(tmp_path / "m", binary=True)
    whole = (tmp_path / "m/images.bin").read_bytes()
    (tmp_path / "m/images.bin").write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    with pytest.raises(FormatError, match="cut off"):
        splatree.read_cameras(tmp_path / "m")


@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("1 2 3", "line 1 "),
        ("1 a b c d e f g 7 x.jpg", "line 1 "),
        ("1 1 0 0 0 0 0 0 8 x.jpg", "x.jpg"),
        ("1 0 0 0 0 0 0 0 7 x.jpg", "x.jpg"),
    ],
)
def test_bad_lines_of_a_text_model_are_refused(tmp_path, line, where):
    write_colmap(tmp_path / "m", binary=False)
    (tmp_path / "m/images.txt").write_text(line + "\n\n")
    with pytest.raises(FormatError, match=f"{where}.*wanted"):
        splatree.read_cameras(tmp_path / "m")


def test_inria_cameras_round_trip(tmp_path):
    K = np.array([[500.0, 0, 300], [0, 520, 260], [0, 0, 1]])
    odd = Camera(POSES[0].camera_from_world, K, 640, 480, near=0.01, name="odd")
    splatree.write_cameras(Cameras((*POSES, odd)), tmp_path / "cameras.json")
    back = splatree.read_cameras(tmp_path)
    for a, b in zip((*POSES, odd), back, strict=True):
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(a.K, b.K)
        assert (a.width, a.height, a.near, a.name) == (b.width, b.height, b.near, b.name)
    with pytest.raises(OutputError, match="exists already"):
        splatree.write_cameras(back, tmp_path / "cameras.json")


def test_inria_rotation_is_camera_to_world_and_position_the_centre(tmp_path):
    splatree.write_cameras([POSES[0]], tmp_path / "c.json")
    (record,) = json.loads((tmp_path / "c.json").read_text())
    np.testing.assert_allclose(record["position"], [3, -2, 1], atol=1e-12)
    forward = np.array(record["rotation"])[:, 2]  # third column: the camera's z axis in the world
    wanted = np.array([0.1, 0.2, 0.3]) - [3, -2, 1]
    np.testing.assert_allclose(forward, wanted / np.linalg.norm(wanted), atol=1e-12)
    assert "cx" not in record and "near" not in record


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width: found 0"),
        ({"rotation": [[1, 0], [0, 1]]}, r"shape \(2, 2\)"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "not orthonormal"),
        ({"position": "here"}, "position"),
        ({"fx": -3}, "focal lengths"),
        ({"fx": float("nan")}, "fx: found NaN"),
        ({"fy": None}, "fy"),
    ],
)
def test_bad_inria_cameras_are_refused_with_their_number(tmp_path, change, message):
    splatree.write_cameras(POSES, tmp_path / "c.json")
    records = json.loads((tmp_path / "c.json").read_text())
    records[1] |= change
    (tmp_path / "c.json").write_text(json.dumps(records))
    with pytest.raises(FormatError, match=f"camera 1.*{message}"):
        splatree.read_cameras(tmp_path / "c.json")


def transforms(**extra):
    frames = []
    for i, camera in enumerate(POSES):
        c2w = np.linalg.inv(camera.camera_from_world) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": c2w.tolist()})
    return {"fl_x": 600, "fl_y": 610, "cx": 320, "cy": 240, "w": 640, "h": 480, "frames": frames, **extra}


def test_nerfstudio_axes_are_flipped_to_opencv(tmp_path):
    (tmp_path / "transforms.json").write_text(json.dumps(transforms(camera_model="OPENCV", k1=0.0)))
    for camera, wanted in zip(splatree.read_cameras(tmp_path), POSES, strict=True):
        np.testing.assert_allclose(camera.camera_from_world, wanted.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(camera.K, [[600, 0, 320], [0, 610, 240], [0, 0, 1]])


def test_a_frame_has_its_own_lens(tmp_path):
    content = transforms()
    content["frames"][1] |= {"fl_x": 300, "w": 320, "h": 240}
    (tmp_path / "t.json").write_text(json.dumps(content))
    cameras = splatree.read_cameras(tmp_path / "t.json")
    assert [c.K[0, 0] for c in cameras] == [600, 300, 600] and cameras[1].width == 320


def test_a_field_of_view_and_a_picture_replace_focal_length_and_size(tmp_path):
    content = transforms()
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    content["camera_angle_x"] = np.pi / 2
    for frame in content["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    (tmp_path / "images").mkdir()
    for i in range(3):
        splatree.write_image(np.zeros((20, 30, 3), np.float32), tmp_path / f"images/{i}.png")
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    camera = splatree.read_cameras(tmp_path)[2]
    np.testing.assert_allclose(camera.K, [[15, 0, 15], [0, 15, 10], [0, 0, 1]])
    (tmp_path / "images/2.png").unlink()  # taken to be as large as the others, and said
    cameras = splatree.read_cameras(tmp_path)
    assert cameras[2].width == 30 and "neither w and h nor a picture" in cameras.notes[0]
    (tmp_path / "images/0.png").unlink()
    with pytest.raises(FormatError, match="frame 0: found no w and h and no picture"):
        splatree.read_cameras(tmp_path)


@pytest.mark.parametrize(
    ("extra", "lens"),
    [
        ({}, None),
        ({"k1": 0.1, "p2": 0.2}, Lens("brown", (0.1,), tangential=(0.0, 0.2))),
        ({"distortion_params": [0.1, 0.0, 0.0, 0.0, 0.3, 0.0]}, Lens("brown", (0.1,), tangential=(0.3, 0.0))),
        ({"camera_model": "OPENCV_FISHEYE", "distortion_params": [0.1, 0.2, 0.0, 0.0]}, Lens("fisheye", (0.1, 0.2))),
        ({"is_fisheye": True}, Lens("fisheye")),
        ({"is_fisheye": 1, "k1": 0.1}, Lens("fisheye", (0.1,))),
        ({"is_fisheye": False, "k1": 0.1}, Lens("brown", (0.1,))),
        ({"is_fisheye": True, "camera_model": "OPENCV", "k1": 0.1}, Lens("fisheye", (0.1,))),
        ({"camera_model": "OPENCV_FISHEYE", "k2": 0.1}, Lens("fisheye", (0.0, 0.1))),
        ({"camera_model": "FULL_OPENCV", "k3": 0.3, "k4": 0.4}, Lens("brown", (0.0, 0.0, 0.3), (0.4,))),
    ],
)
@pytest.mark.parametrize("of_frame", [False, True])
def test_lenses_of_nerfstudio_stand_in_the_file_or_in_a_frame(tmp_path, extra, lens, of_frame):
    content = transforms()
    if of_frame:
        content["frames"][0] |= extra
    else:
        content |= extra
    (tmp_path / "t.json").write_text(json.dumps(content))
    assert splatree.read_cameras(tmp_path / "t.json")[0].lens == lens


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR.*cut flat pictures"),
        ({"rolling_shutter": [0, 0, 1, 0]}, "found rolling_shutter"),
        ({"distortion_params": [0.1, 0.2, 0.3]}, "found 3 numbers, wanted k1 k2 k3 k4 p1 p2"),
        ({"k1": "x"}, "k1: found a string"),
        ({"is_fisheye": "yes"}, "is_fisheye: found 'yes', wanted true or false"),
        ({"frames": 3}, "wanted a list"),
        ({"frames": [{}]}, "frame 0: found no key 'transform_matrix'"),
        ({"fl_x": "x"}, "fl_x"),
        ({"w": 0}, "w: found 0"),
    ],
)
def test_bad_transforms_are_refused(tmp_path, extra, message):
    (tmp_path / "t.json").write_text(json.dumps(transforms(**extra)))
    with pytest.raises(FormatError, match=message):
        splatree.read_cameras(tmp_path / "t.json")


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("a.json", FormatError, "found other JSON"),
        ("b.json", FormatError, "not valid JSON"),
        ("c.json", FormatError, "c.json: found no camera in it"),
        ("gone", InputError, "not found"),
        ("empty", InputError, "found no cameras in this folder"),
        ("cameras.txt", InputError, "found no COLMAP model"),
    ],
)
def test_what_holds_no_cameras_is_refused(tmp_path, name, error, message):
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "b.json").write_text("{")
    (tmp_path / "c.json").write_text("[]")
    (tmp_path / "cameras.txt").write_text("")
    (tmp_path / "empty").mkdir()
    with pytest.raises(error, match=message):
        splatree.read_cameras(tmp_path / name)


@pytest.mark.parametrize(("name", "count"), [("caliterra_drone", 75), ("snowmiku_plush_small", 97)])
def test_real_colmap_models_agree_with_their_cameras_json(data, name, count):
    """A binary and a text model; the JSON was written by other code."""
    colmap = splatree.read_cameras(data / "images" / name)
    inria = {c.name: c for c in splatree.read_cameras(data / "images" / name / "cameras.json")}
    assert len(colmap) == len(inria) == count
    for camera in colmap:
        other = inria[camera.name.rsplit(".", 1)[0]]
        np.testing.assert_allclose(camera.camera_from_world, other.camera_from_world, atol=1e-9)  # through the centre
        np.testing.assert_allclose(camera.K, other.K)


def test_real_inria_cameras(data):
    assert len(splatree.read_cameras(data / "cameras/mipnerf360_bicycle_inria_cameras.json")) == 193
