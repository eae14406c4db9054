import os
import sys

import pytest

from splatree.errors import OutputError
from splatree.io import replacing as module


def test_on_windows_no_folder_is_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ON_WINDOWS", True)
    flushed = []
    monkeypatch.setattr(module, "flush", lambda path, flags: flushed.append(path))
    with module.replacing(tmp_path / "a") as path:
        path.write_bytes(b"new")
    assert (tmp_path / "a").read_bytes() == b"new"
    assert tmp_path not in flushed and len(flushed) == 1


def test_a_file_that_windows_holds_open_is_explained(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ON_WINDOWS", True)
    (tmp_path / "a").write_bytes(b"old")
    with (
        pytest.raises(OutputError, match="Windows replaces no file that is open or mapped: close the scene"),
        module.replacing(tmp_path / "a", force=True),
    ):
        raise PermissionError(13, "Access is denied")
    assert (tmp_path / "a").read_bytes() == b"old"


UNIX = pytest.mark.skipif(sys.platform == "win32", reason="names, files and folders as on Unix")


@UNIX
@pytest.mark.parametrize("way", ["new", "new without hard links", "forced"])
def test_the_target_becomes_the_file_that_was_written_and_not_a_copy_of_it(tmp_path, monkeypatch, way):
    """A copy can be seen half written, and an interrupted one leaves half a file."""
    if way == "new without hard links":
        monkeypatch.setattr("pathlib.Path.hardlink_to", _no_hard_links)
    target = tmp_path / "a"
    if way == "forced":
        target.write_text("old")
    with module.replacing(target, force=way == "forced") as path:
        path.write_text("new")
        written = path.stat().st_ino
        reader = target.open() if way == "forced" else None
    assert target.stat().st_ino == written
    if reader is not None:
        with reader:
            assert reader.read() == "old"  # as whoever has mapped a scene goes on reading it


@UNIX
@pytest.mark.parametrize("force", [False, True])
def test_the_bytes_are_on_the_disk_before_the_name_and_the_name_before_the_end(tmp_path, monkeypatch, force):
    target = tmp_path / "a"
    if force:
        target.write_text("old")
    flushed = []
    real = os.fsync

    def fsync(descriptor):
        flushed.append((os.fstat(descriptor).st_ino, target.read_text() if target.exists() else None))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    with module.replacing(target, force=force) as path:
        path.write_text("new")
        assert flushed == []
    before = "old" if force else None
    assert flushed == [(target.stat().st_ino, before), (tmp_path.stat().st_ino, "new")]


def _no_hard_links(self, target):
    raise OSError(1, "Operation not permitted")


@UNIX
def test_a_temporary_file_that_another_writer_took_for_abandoned_is_left_for_a_new_one(tmp_path, monkeypatch):
    real, taken = module.lock, []

    def locked(descriptor):
        taken.append(descriptor)
        return len(taken) > 1 and real(descriptor)

    monkeypatch.setattr(module, "lock", locked)
    with module.replacing(tmp_path / "a") as path:
        assert list(tmp_path.iterdir()) == [path]
        path.write_text("new")
    assert (tmp_path / "a").read_text() == "new" and len(taken) == 2
    assert list(tmp_path.iterdir()) == [tmp_path / "a"]


def test_folders_are_checked_before_any_work_and_none_is_made(tmp_path):
    module.check_free_in(tmp_path / "new" / "deep", ["a.json"], force=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(OutputError, match=r"a\.json: exists already; choose another folder"):
        module.check_free_in(tmp_path, ["b.csv", "a.json"], force=False)
    module.check_free_in(tmp_path, ["a.json"], force=True)
    for below in ("a.json", "a.json/deep"):
        with pytest.raises(OutputError, match=r"cannot be made a folder, .*a\.json is a file"):
            module.check_free_in(tmp_path / below, [], force=False)
