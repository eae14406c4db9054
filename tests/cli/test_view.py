"""``splatree view`` as a program: it says where to look, answers there, and ends at an interruption."""

import json
import signal
import subprocess
import sys
import urllib.request

import pytest

from .conftest import listen_to_interruptions


def started(*words):
    command = [sys.executable, "-m", "splatree", "view", "--no-browser", *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listen_to_interruptions
    )


def test_it_serves_until_it_is_interrupted(small_tree):
    process = started(small_tree, "--json", "--budget", "5000")
    try:
        line = process.stderr.readline()
        assert line.startswith("look at http://127.0.0.1:")
        with urllib.request.urlopen(line.split()[-1], timeout=20) as answer:
            page = answer.read().decode()
        assert "small.splatree" in page
        assert "ssh -L" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0, err
    viewed = json.loads(out)
    assert viewed["url"] == line.split()[-1]
    assert viewed["num_nodes"] > 3161


def test_ctrl_c_while_the_browser_opens_is_the_usual_end_too(splatree, small_tree, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("webbrowser.open", interrupt)
    code, out, err = splatree("view", small_tree, "--budget", "5000")
    assert code == 0, err
    assert "nodes at http://127.0.0.1" in out


def test_folders_of_parts_are_shown_without_reading_all_of_them(splatree, small_ply, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    folder = tmp_path / "parts.splatree"
    assert splatree("build", small_ply, folder, "--part-rows", "500", "-q")[0] == 0
    monkeypatch.setattr("webbrowser.open", interrupt)
    monkeypatch.setattr("splatree.cli.opening.read_scene", None)  # nothing is read as a whole
    for words in ((), ("--max-memory", "1M"), ("--beside", folder)):
        code, out, err = splatree("view", folder, "--budget", "5000", *words)
        assert code == 0, err
        assert "nodes at http://127.0.0.1" in out
    assert splatree("view", folder, "--quality", "40", "--max-memory", "1M")[0] == 0


def test_photos_want_their_cameras(splatree, small_ply, tmp_path):
    code, _, err = splatree("view", small_ply, "--photos", tmp_path)
    assert code == 2
    assert "found --photos without --cameras" in err


@pytest.mark.parametrize("option", [("--budget", "10"), ("--port", "70000"), ("--host", "")])
def test_options_that_cannot_be_are_refused_at_once(splatree, small_ply, option):
    code, _, err = splatree("view", small_ply, *option)
    assert code == 2
    assert "wanted" in err


def test_a_large_scene_without_levels_is_told_of(splatree, small_ply, monkeypatch):
    from splatree.view import exhibit
    from splatree.view.viewer import Viewer

    monkeypatch.setattr(exhibit, "FLAT_MAX", 1000)
    monkeypatch.setattr(Viewer, "wait", lambda viewer: None)
    code, out, err = splatree("view", small_ply, "--no-browser")
    assert code == 0
    assert "has no levels of detail; building them" in err
    assert "nodes at http://127.0.0.1" in out
