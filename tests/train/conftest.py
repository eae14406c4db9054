"""Photographs to train on: pictures of a known scene, in the folders that COLMAP and nerfstudio leave."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.maths.rotations import quat_from_matrix

from ..scenes import cloud

SIZE_PX = 64


@pytest.fixture(scope="session")
def truth():
    """200 Gaussians in a ball of the size of a head."""
    return st.Scene.flat(cloud(200, 3, spread=0.6, log_scales=("uniform", -2.6, -1.4), logits=("normal", 1, 1), sh=0.8))


def views(count, size=SIZE_PX):
    """Cameras round the ball, three units away."""
    turns = [0.45 * i for i in range(count)]
    cameras = [
        st.Camera.look_at(
            np.array([3 * np.sin(turn), -0.8, -3 * np.cos(turn)]), np.zeros(3), width=size, height=size, fov_y_deg=45
        )
        for turn in turns
    ]
    return [replace(camera, name=f"photo_{i}.png") for i, camera in enumerate(cameras)]


def write_colmap(folder, cameras, points=None, colors=None):
    """A COLMAP model as text."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    K = cameras[0].K
    numbers = " ".join(map(str, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
    (model / "cameras.txt").write_text(f"1 PINHOLE {cameras[0].width} {cameras[0].height} {numbers}\n")
    lines = []
    for i, camera in enumerate(cameras):
        pose = camera.camera_from_world
        q = quat_from_matrix(pose[:3, :3])
        lines += [f"{i + 1} {' '.join(map(str, [*q, *pose[:3, 3]]))} 1 {camera.name}", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    if points is not None:
        rows = [
            f"{i + 1} {x} {y} {z} {r} {g} {b} 0.5 1 0 2 0 3 0"
            for i, ((x, y, z), (r, g, b)) in enumerate(zip(points, colors, strict=True))
        ]
        (model / "points3D.txt").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="session")
def kept_photographs(truth, tmp_path_factory):
    """Four photographs of the ball, of which the first is held out by every rule of n ≥ 4, and points near the Gaussians."""
    folder = tmp_path_factory.mktemp("ball") / "photographs"
    (folder / "images").mkdir(parents=True)
    cameras = views(4)
    for camera in cameras:
        st.write_image(st.render(truth, camera).image, folder / "images" / camera.name)
    rng = np.random.default_rng(0)
    points = truth.gaussians.means + rng.normal(0, 0.05, (len(truth), 3))
    write_colmap(folder, cameras, points, rng.integers(0, 256, (len(truth), 3)))
    return folder


@pytest.fixture
def photographs(kept_photographs, tmp_path):
    """The photographs in a folder that the test may change."""
    return shutil.copytree(kept_photographs, tmp_path / "photographs")
