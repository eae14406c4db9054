"""Parts of a stream in a folder."""

import pytest

import splatree as st
from splatree.stream.parts import Folder


def test_a_part_that_another_process_wrote_first_is_kept(tmp_path):
    folder, name = Folder(tmp_path / "stream", "lod-meta.json", force=False), "0_0-0123456789ab"
    folder.write_part(name, {"meta.json": b"{}"})
    folder.write_part(name, {"meta.json": b"{}"})
    assert [entry.name for entry in folder.path.iterdir()] == [name]
    assert folder.part_bytes(name) == 2


def test_a_part_that_cannot_be_written_is_told(tmp_path):
    folder = Folder(tmp_path / "stream", "lod-meta.json", force=False)
    with pytest.raises(st.OutputError, match=r"0_0-0123456789ab: could not be written \(No such file or directory\)"):
        folder.write_part("0_0-0123456789ab", {"missing/meta.json": b"{}"})
    assert list(folder.path.iterdir()) == []
