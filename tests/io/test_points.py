"""The points of COLMAP models, and of nerfstudio."""

import json
import struct

import numpy as np
import pytest

import splatree as st
from splatree.io.cameras.point_cloud import read_point_cloud
from splatree.io.cameras.points import read_points


def model(folder):
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text("1 PINHOLE 8 8 8 8 4 4\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    return folder


PLACES = np.array([[1.5, -2, 3], [4, 5, 6.25]])
COLORS = np.array([[0, 128, 255], [9, 8, 7]], np.uint8)


def write_binary(folder, places=PLACES):
    data = struct.pack("<Q", len(places))
    for i, (place, color) in enumerate(zip(places, COLORS, strict=True)):
        data += struct.pack("<Q3d3Bd", i, *place, *color, 0.5) + struct.pack("<Q", i + 2) + bytes(8 * (i + 2))
    (folder / "points3D.bin").write_bytes(data)
    return data


def write_text(folder):
    lines = [
        f"{i} {' '.join(map(str, place))} {' '.join(map(str, color))} 0.5{' 1 2' * (i + 2)}"
        for i, (place, color) in enumerate(zip(PLACES, COLORS, strict=True))
    ]
    (folder / "points3D.txt").write_text("# comment\n" + "\n".join(lines) + "\n")


@pytest.mark.parametrize("write", [write_binary, write_text])
@pytest.mark.parametrize("place", ["sparse/0", "colmap/sparse/0", "."])
def test_points_are_read_from_where_cameras_are(tmp_path, write, place):
    write(model(tmp_path / "set" / place))
    points = read_points(tmp_path / "set")
    np.testing.assert_array_equal(points.places, PLACES)
    np.testing.assert_array_equal(points.colors, COLORS)
    assert points.num_pictures.tolist() == [2, 3]


def test_points_move_with_the_cameras_of_a_training(tmp_path):
    write_binary(model(tmp_path / "set" / "sparse" / "0"))
    turn = [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30]]
    (tmp_path / "set" / "dataparser_transforms.json").write_text(f'{{"transform": {turn}, "scale": 0.5}}')
    moved = read_points(tmp_path / "set")
    np.testing.assert_allclose(moved.places[0], 0.5 * np.array([2 + 10, 1.5 + 20, 3 + 30]))
    camera = st.read_cameras(tmp_path / "set")[0]  # at the zero of the model
    np.testing.assert_allclose(camera.position, 0.5 * np.array([10, 20, 30]))


def test_no_points_are_none(tmp_path):
    assert read_points(tmp_path) is None
    folder = model(tmp_path / "sparse" / "0")
    assert read_points(tmp_path) is None
    (folder / "points3D.txt").write_text("# none\n")
    assert read_points(tmp_path) is None


def test_damaged_points_are_refused(tmp_path):
    folder = model(tmp_path / "sparse" / "0")
    whole = write_binary(folder)
    for size in (3, 20, len(whole) - 60, len(whole) - 1):
        (folder / "points3D.bin").write_bytes(whole[:size])
        with pytest.raises(st.FormatError, match=r"points3D.bin: .*the file is cut off"):
            read_points(tmp_path)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    with pytest.raises(st.FormatError, match="cut off"):
        read_points(tmp_path)
    write_binary(folder, np.array([[1, 2, 3], [np.nan, 0, 0]]))
    with pytest.raises(st.FormatError, match=r"point 2 of 2: found \[nan"):
        read_points(tmp_path)
    write_binary(folder, np.array([[1, 2, 3], [0, -1e300, 0]]))
    with pytest.raises(st.FormatError, match=r"point 2 of 2: found .*, wanted places within 1e\+18 of zero"):
        read_points(tmp_path)
    (folder / "points3D.bin").unlink()
    (folder / "points3D.txt").write_text("1 2 3 4 300 0 0 0.5\n")
    with pytest.raises(st.FormatError, match=r"line 1: found '1 2 3 4 300 0 0 0.5'"):
        read_points(tmp_path)


def nerfstudio(folder, **fields):
    """A transforms.json with one view."""
    folder.mkdir()
    frame = {"file_path": "a.png", "w": 8, "h": 8, "fl_x": 8, "transform_matrix": np.eye(4).tolist()}
    (folder / "transforms.json").write_text(json.dumps({"frames": [frame], **fields}))
    return folder


def write_ply(path, encoding="ascii"):
    kinds = {**dict.fromkeys("xyz", "float"), **dict.fromkeys(("red", "green", "blue"), "uchar")}
    lines = [f"property {kind} {name}" for name, kind in kinds.items()]
    head = "\n".join(["ply", f"format {encoding} 1.0", "element vertex 2", *lines, "end_header", ""])
    if encoding == "ascii":
        rows = [" ".join(map(str, [*place, *color])) for place, color in zip(PLACES, COLORS, strict=True)]
        path.write_text(head + "\n".join(rows) + "\n")
        return
    order = "<" if "little" in encoding else ">"
    rows = [struct.pack(f"{order}3f3B", *place, *color) for place, color in zip(PLACES, COLORS, strict=True)]
    path.write_bytes(head.encode() + b"".join(rows))


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_point_clouds_are_read_and_refused_when_cut_off(tmp_path, encoding):
    path = tmp_path / "a.ply"
    write_ply(path, encoding)
    places, colors = read_point_cloud(path)
    np.testing.assert_array_equal(places, PLACES)
    np.testing.assert_array_equal(colors, COLORS)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(st.FormatError, match="cut off"):
        read_point_cloud(path)
    path.write_bytes(path.read_bytes().replace(b" x\n", b" u\n"))
    with pytest.raises(st.FormatError, match="found no property x, wanted points with x y z"):
        read_point_cloud(path)


def test_points_of_nerfstudio_are_in_the_frame_of_its_poses(tmp_path):
    folder = nerfstudio(tmp_path / "set", ply_file_path="sparse_pc.ply")
    write_ply(folder / "sparse_pc.ply")
    for of in (folder, folder / "transforms.json"):
        points = read_points(of)
        np.testing.assert_allclose(points.places, PLACES)
        np.testing.assert_array_equal(points.colors, COLORS)
        assert not points.num_pictures.any()


def test_points_of_nerfstudio_move_with_the_cameras_of_a_training(tmp_path):
    applied = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 5]]
    folder = nerfstudio(tmp_path / "set", ply_file_path="sparse_pc.ply", applied_transform=applied, applied_scale=2.0)
    write_ply(folder / "sparse_pc.ply")
    before, view = read_points(folder).places, st.read_cameras(folder)[0]
    turn = [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30]]
    (folder / "dataparser_transforms.json").write_text(f'{{"transform": {turn}, "scale": 0.5}}')
    after, moved = read_points(folder).places, st.read_cameras(folder)[0]

    def seen(camera, places):
        return places @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]

    # what a view sees is the same, but for the scale: 0.5 / 2
    np.testing.assert_allclose(seen(moved, after), 0.25 * seen(view, before), atol=1e-12)


def test_a_point_file_that_is_missing_is_refused(tmp_path):
    folder = nerfstudio(tmp_path / "set", ply_file_path="gone.ply")
    with pytest.raises(st.InputError, match=r"transforms\.json: ply_file_path: .*gone\.ply: not found"):
        read_points(folder)
    assert read_points(nerfstudio(tmp_path / "other")) is None
