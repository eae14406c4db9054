import pytest

from splatree.errors import OutputError
from splatree.io import replacing as module


def test_on_windows_no_folder_is_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ON_WINDOWS", True)
    flushed = []
    monkeypatch.setattr(module, "_flush", lambda path, flags: flushed.append(path))
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
