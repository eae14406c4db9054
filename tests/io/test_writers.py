"""Several writers of one file, writers that were killed, the mode of a file, links in a circle."""

import os
import subprocess
import sys
import textwrap

import pytest

from splatree.errors import OutputError
from splatree.io.replacing import check_target, replacing

LINUX = pytest.mark.skipif(sys.platform == "win32", reason="locks, modes and links as on Unix")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def started(code, *arguments):
    """A Python process that runs a program, with its output piped."""
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


WRITER = """
    import sys
    from splatree.errors import OutputError
    from splatree.io.replacing import replacing
    try:
        with replacing(sys.argv[1]) as path:
            path.write_text(sys.argv[2])
            print("ready", flush=True)
            sys.stdin.readline()
    except OutputError as error:
        print("lost", error)
    else:
        print("won")
"""


@LINUX
def test_of_six_racing_writers_one_wins(tmp_path):
    target = tmp_path / "out"
    writers = [started(WRITER, target, str(i)) for i in range(6)]
    for writer in writers:
        assert writer.stdout.readline() == "ready\n"  # all have found the name free
    said = [writer.communicate("\n")[0] for writer in writers]
    assert sorted(line.split()[0] for line in said) == ["lost"] * 5 + ["won"]
    assert all("exists already" in line for line in said if line.startswith("lost"))
    assert target.read_text() == str(said.index("won\n"))
    assert names(tmp_path) == ["out"]


@LINUX
def test_what_a_killed_writer_left_is_removed_by_the_next_and_what_is_in_work_stays(tmp_path):
    killed, at_work = started(WRITER, tmp_path / "a", "1"), started(WRITER, tmp_path / "b", "2")
    for writer in (killed, at_work):
        assert writer.stdout.readline() == "ready\n"
    killed.kill()
    killed.communicate()
    (tmp_path / ".mine.0123abcd.tmp").write_text("of another program")
    assert len(names(tmp_path)) == 3
    with replacing(tmp_path / "c") as path:
        path.write_text("3")
    left = names(tmp_path)
    assert [name for name in left if "splatree" in name] == [name for name in left if name.startswith(".b.")]
    assert ".mine.0123abcd.tmp" in left
    assert at_work.communicate("\n")[0] == "won\n"
    assert names(tmp_path) == [".mine.0123abcd.tmp", "b", "c"]


@LINUX
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755])
def test_a_replaced_file_keeps_its_mode(tmp_path, mode):
    (tmp_path / "a").write_text("old")
    (tmp_path / "a").chmod(mode)
    with replacing(tmp_path / "a", force=True) as path:
        path.write_text("new")
    assert (tmp_path / "a").read_text() == "new"
    assert (tmp_path / "a").stat().st_mode & 0o777 == mode


@LINUX
def test_a_new_file_has_the_mode_that_the_user_wants(tmp_path):
    before = os.umask(0o027)
    try:
        with replacing(tmp_path / "a") as path:
            path.write_text("new")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


@LINUX
def test_where_no_file_can_have_two_names_one_writer_wins_too(tmp_path, monkeypatch):
    def refused(self, target):
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr("pathlib.Path.hardlink_to", refused)
    with replacing(tmp_path / "a") as path:
        path.write_text("first")
    with pytest.raises(OutputError, match="exists already"), replacing(tmp_path / "b") as path:
        path.write_text("second")
        (tmp_path / "b").write_text("faster")
    assert ((tmp_path / "a").read_text(), (tmp_path / "b").read_text()) == ("first", "faster")
    assert names(tmp_path) == ["a", "b"]


@LINUX
def test_links_in_a_circle_are_told(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OutputError, match="cannot be written"):
        check_target(tmp_path / "a")


@LINUX
def test_a_link_leads_to_what_is_replaced(tmp_path):
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with replacing(tmp_path / "link", force=True) as path:
        path.write_text("new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "new"
