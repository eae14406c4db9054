"""A folder with all files that pages and docstrings name, for tests that run what these show."""

import json
import shutil
import webbrowser
from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st


@pytest.fixture(scope="session")
def shown_files(tmp_path_factory):
    """A folder with all the files that the pages name, of 300 real Gaussians."""
    folder = tmp_path_factory.mktemp("shown")
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = st.read(path)
    scene = st.Scene.flat(scene.gaussians.take(np.arange(0, len(scene), 1000)))
    for name in ("city.ply", "scene.ply", "in.ply", "big.ply", "city.sog", "scene.sog"):
        st.write(scene, folder / name)
    tree = st.build_clusters(st.build_lod(scene), 9)
    for name in ("city.splatree", "scene.splatree"):
        st.write(tree, folder / name)
    for name, rows in (("chunk_0", np.arange(150)), ("chunk_1", np.arange(150, len(scene)))):
        (folder / name).mkdir()
        st.write(st.Scene.flat(scene.gaussians.take(rows)), folder / name / "point_cloud.ply")
    cameras = st.flyout(scene, st.PathOptions(views=10, width=64, height=36))
    (folder / "photographs").mkdir()
    for name in ("cameras.json", "train.json", "photographs/cameras.json"):
        st.write_cameras(cameras, folder / name)
    for camera in cameras:
        st.write_image(st.render(scene, camera).image, folder / "photographs" / f"{camera.name}.png")
    st.write(tree, folder / "site.splatree")
    shutil.copytree(folder / "photographs", folder / "site")
    streamed = folder / "playbot"
    streamed.mkdir()
    levels = [scene, st.thin(scene, st.ThinOptions(keep=0.2)).scene]
    for i, level in enumerate(levels):
        st.write(level, streamed / f"{i}_0" / "meta.json")
    lods = {str(i): {"file": i, "offset": 0, "count": len(level)} for i, level in enumerate(levels)}
    manifest = {"lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": {"lods": lods}}
    (streamed / "lod-meta.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture
def shown_folder(shown_files, tmp_path, monkeypatch):
    """A copy of it, and the current folder."""
    copy = shutil.copytree(shown_files, tmp_path / "copy")
    monkeypatch.chdir(copy)
    monkeypatch.setattr(st.Viewer, "wait", lambda viewer: None)  # a page that nobody looks at
    monkeypatch.setattr(webbrowser, "open", lambda url: True)
    return copy
