"""Thinning through files: the file of thinning in memory, byte for byte."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.outofcore import run

from ..laws.hard_scenes import hard_scene, hard_scenes

SMALL = st.FolderOptions(part_rows=200)


def file_of_memory(path, output, options, mode=None):
    """What `thin` and `write` make of a file."""
    scene = st.read(path)
    thinned = st.thin(scene if mode is None else replace(scene, mode=mode), options)
    st.write(thinned.scene, output, force=True)
    return output.read_bytes(), thinned


@settings(max_examples=25, deadline=None)
@given(
    gaussians=hard_scenes(most=300, degree=1),
    part_rows=hs.sampled_from([16, 60, 1000]),
    amount=hs.sampled_from(
        [{}, {"radius": 0.0}, {"radius": 0.15}, {"radius": 1.5}, {"keep": 0.5}, {"keep": 0.1}, {"count": 7}]
    ),
    color_radius=hs.sampled_from([None, 0.5]),
    mode=hs.sampled_from(["classic", "antialiased"]),
)
def test_the_file_is_that_of_thinning_in_memory(tmp_path_factory, gaussians, part_rows, amount, color_radius, mode):
    folder = tmp_path_factory.mktemp("scene")
    st.write(st.Scene.flat(gaussians), folder / "in.ply")
    options = st.ThinOptions(method="radius", color_radius=color_radius, **amount)

    def through_files():
        running = st.FolderOptions(part_rows=part_rows)
        return st.thin_file(folder / "in.ply", folder / "out.ply", options, running, mode=mode)

    try:
        wanted, thinned = file_of_memory(folder / "in.ply", folder / "memory.ply", options, mode)
    except st.InputError as error:  # colours are too far apart
        with pytest.raises(st.InputError) as found:
            through_files()
        assert str(found.value) == str(error)
        return
    done = through_files()
    assert (folder / "out.ply").read_bytes() == wanted
    assert (done.num_read, done.num_written, done.radius) == (len(gaussians), len(thinned), thinned.radius)
    assert done.options == thinned.options
    assert sorted(path.name for path in folder.iterdir()) == ["in.ply", "memory.ply", "out.ply"]


@pytest.mark.parametrize("suffix", [".spz", ".splat", ".ksplat", ".sog", ".splatree", ".compressed.ply", ".hier"])
def test_any_format_that_is_written_in_chunks(tmp_path, ply, suffix):
    options, target = st.ThinOptions(radius=0.3), tmp_path / f"out{suffix}"
    if suffix == ".hier":
        with pytest.raises(st.InputError):
            st.thin_file(ply, target, options, SMALL)
        return
    copy = tmp_path / "copy.ply"
    copy.write_bytes(ply.read_bytes())
    st.thin_file([ply, copy], target, options, SMALL)
    thinned = st.thin(st.read([ply, copy]), options)
    st.write(thinned.scene, tmp_path / f"memory{suffix}")
    assert target.read_bytes() == (tmp_path / f"memory{suffix}").read_bytes()


def test_an_interrupted_thinning_goes_on_where_it_stopped(tmp_path, ply, monkeypatch):
    options = st.ThinOptions(method="radius", keep=0.4)
    done, do_piece = [], run.do_piece

    def stopping(*job):
        if job[2] == "thin" and sum(other[2] == "thin" for other in done) == 2:
            raise KeyboardInterrupt
        done.append(job)
        do_piece(*job)

    monkeypatch.setattr(run, "do_piece", stopping)
    with pytest.raises(KeyboardInterrupt):
        st.thin_file(ply, tmp_path / "out.ply", options, SMALL)
    assert not (tmp_path / "out.ply").exists()
    again = []
    monkeypatch.setattr(run, "do_piece", lambda *job: (again.append(job), do_piece(*job)))
    st.thin_file(ply, tmp_path / "out.ply", options, SMALL)
    assert {job[2] for job in again} == {"thin"} and not {job[3] for job in again} & {
        job[3] for job in done if job[2] == "thin"
    }
    assert (tmp_path / "out.ply").read_bytes() == file_of_memory(ply, tmp_path / "memory.ply", options)[0]


def test_workers_make_the_same_file(tmp_path, ply):
    options = st.ThinOptions(radius=0.2)
    with ThreadPoolExecutor(3) as executor:
        st.thin_file(ply, tmp_path / "out.ply", options, SMALL, executor=executor)
    assert (tmp_path / "out.ply").read_bytes() == file_of_memory(ply, tmp_path / "memory.ply", options)[0]


def test_what_cannot_be_thinned_through_files_is_refused(tmp_path, ply, monkeypatch):
    with pytest.raises(st.InputError, match="found 'pairs' for thinning through files"):
        st.thin_file(ply, tmp_path / "out.ply", st.ThinOptions(keep=0.5))
    with pytest.raises(st.InputError, match="hier is not written in chunks"):
        st.thin_file(ply, tmp_path / "out.hier", st.ThinOptions(radius=0.2))
    (tmp_path / "out.ply").write_bytes(b"mine")
    with pytest.raises(st.OutputError, match="exists"):
        st.thin_file(ply, tmp_path / "out.ply", st.ThinOptions(radius=0.2), SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["out.ply"]
    monkeypatch.setattr("splatree.outofcore.thin.cell_bytes", lambda rows, k: rows * 10**9)
    with pytest.raises(st.InputError, match=r"Gaussians that a radius of 30 reaches over.*raise --max-memory"):
        st.thin_file(ply, tmp_path / "far.ply", st.ThinOptions(radius=30.0), SMALL)


def test_a_thinning_is_not_taken_for_a_build(tmp_path, ply, monkeypatch):
    monkeypatch.setattr(run, "do_piece", None)
    with pytest.raises(TypeError):
        st.thin_file(ply, tmp_path / "out.ply", st.ThinOptions(radius=0.2), SMALL)
    monkeypatch.undo()
    plan = json.loads((tmp_path / "out.ply.work" / "plan.json").read_text())
    assert plan["request"]["verb"] == "ThinOptions"
    st.write(st.Scene.flat(hard_scene(300, "line", 2)), tmp_path / "other.ply")
    st.thin_file(tmp_path / "other.ply", tmp_path / "out.ply", st.ThinOptions(radius=0.2), SMALL)
    wanted = file_of_memory(tmp_path / "other.ply", tmp_path / "memory.ply", st.ThinOptions(radius=0.2))[0]
    assert (tmp_path / "out.ply").read_bytes() == wanted
