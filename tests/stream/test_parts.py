"""Parts of a stream in a folder: what is kept is whole, in every format."""

import os
import shutil
from functools import partial

import numpy as np
import pytest

import splatree as st
from splatree.stream.parts import Folder, digest_of, write_files
from splatree.stream.stream import stream

from .conftest import forest

FORMATS = {
    "sog": ("sog", "city", st.StreamOptions(chunk_leaves=40, unit_rows=150, levels=3)),
    "3dtiles": ("3dtiles", "city", st.StreamOptions(tile_nodes=100)),
    "rad": ("rad", "city.rad", st.StreamOptions(chunked=True)),
}


def bytes_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def scene():
    return forest(900, seed=5, sh_degree=1)


def flipped(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def cut_short(path):
    path.write_bytes(path.read_bytes()[:-1])


def emptied(path):
    path.write_bytes(b"")


def a_file_too_many(path):
    (path.parent / "more.webp").write_bytes(b"")


DAMAGES = (flipped, cut_short, emptied, os.unlink)


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("resumes", [True, False], ids=["resumed", "forced"])
def test_a_damaged_part_is_made_again(scene, format, resumes, tmp_path):
    name, output, options = FORMATS[format]
    fresh, damaged = tmp_path / "fresh", tmp_path / "damaged"
    fresh.mkdir()
    done = stream(scene, fresh / output, name, options)
    manifests = {"lod-meta.json", "tileset.json", output}
    parts = sorted(path for path in fresh.rglob("*") if path.is_file() and path.name not in manifests)
    assert len(parts) > (0 if format == "rad" else 3)
    for damage in (*DAMAGES, *([a_file_too_many] if format == "sog" else [])):
        shutil.copytree(fresh, damaged)
        damage(damaged / parts[len(parts) // 2].relative_to(fresh))
        if resumes:
            next(path for path in damaged.rglob("*") if path.is_file() and path.name in manifests).unlink()
        again = stream(scene, damaged / output, name, options, force=not resumes)
        assert bytes_of(damaged) == bytes_of(fresh)
        if format != "rad":  # whose chunks are all made again
            assert again.num_parts_kept == done.num_parts - 1
            is_gone = damage is os.unlink and format == "3dtiles"
            assert again.num_parts_damaged == (0 if is_gone else 1)
        shutil.rmtree(damaged)


def test_a_part_of_an_older_stream_with_one_digest_is_made_again(scene, tmp_path):
    _, output, options = FORMATS["sog"]
    done = stream(scene, tmp_path / output, "sog", options)
    before = bytes_of(done.output)
    part = next(path for path in done.output.iterdir() if path.is_dir())
    part.rename(part.with_name(part.name.rpartition("-")[0]))
    again = stream(scene, done.output, "sog", options, force=True)
    assert again.num_parts_kept == again.num_parts - 1 and bytes_of(done.output) == before


def test_a_part_that_another_process_wrote_first_is_kept(tmp_path):
    folder, name = Folder(tmp_path / "stream", "lod-meta.json", force=False), "0_0-0123456789ab"
    whole = [folder.make(name, partial(write_files, {"meta.json": b"{}"})) for _ in range(2)]
    assert whole[0] == whole[1] and [entry.name for entry in folder.path.iterdir()] == whole[:1]
    assert folder.part_bytes(whole[0]) == 2


def test_a_part_that_is_damaged_before_it_is_made_is_replaced(tmp_path):
    folder, name = Folder(tmp_path / "stream", "lod-meta.json", force=False), "0_0-0123456789ab"
    write = partial(write_files, {"meta.json": b"{}"})
    whole = folder.make(name, write)
    (folder.path / whole / "meta.json").write_bytes(b"")
    assert folder.make(name, write) == whole
    assert (folder.path / whole / "meta.json").read_bytes() == b"{}"


def test_a_part_that_cannot_be_written_is_told(tmp_path):
    folder = Folder(tmp_path / "stream", "lod-meta.json", force=False)
    with pytest.raises(st.OutputError, match=r"0_0-0123456789ab: could not be written \(No such file or directory\)"):
        folder.make("0_0-0123456789ab", partial(write_files, {"missing/meta.json": b"{}"}))
    assert list(folder.path.iterdir()) == []


def test_names_of_parts_do_not_tell_numpys_texts_from_pythons(scene):
    g = scene.gaussians
    assert digest_of(g, np.str_("classic"), (np.int64(2),)) == digest_of(g, "classic", (2,))
    assert digest_of(g, "classic") != digest_of(g, "antialiased")
