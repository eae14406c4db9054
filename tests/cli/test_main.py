"""Errors, exit codes and what is printed where."""

import json
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from splatree import Scene, read, write
from splatree.cli.main import VERBS

COMMAND = [sys.executable, "-m", "splatree"]


def test_help_names_every_verb(splatree):
    code, out, _ = splatree("--help")
    assert code == 0
    assert all(verb in out for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_explains_its_options(splatree, verb):
    code, out, _ = splatree(verb, "--help")
    assert code == 0
    assert "--json" in out and "--verbose" in out and "--quiet" in out


@pytest.mark.parametrize("words", [("bild",), ("info", "--no-such-option"), ("render", "x.ply", "--pixel-error", "-1")])
def test_wrong_command_line_is_code_2(splatree, words):
    code, out, err = splatree(*words)
    assert code == 2
    assert out == ""
    assert err


def one_line(run, *, wanted=1):
    code, out, err = run
    assert code == wanted
    assert out == ""
    assert err.count("\n") == 1 and "error: " in err and "Traceback" not in err
    return err


@pytest.mark.parametrize("verb", ["info", "convert", "thin", "build", "render", "eval"])
def test_missing_input_is_one_line_that_names_it(splatree, tmp_path, verb):
    outputs = {"render": ["-o", tmp_path / "frames"], "info": [], "eval": []}.get(verb, [tmp_path / "out.splatree"])
    assert "nothing.ply" in one_line(splatree(verb, tmp_path / "nothing.ply", *outputs))
    assert list(tmp_path.iterdir()) == []


def test_existing_output_is_replaced_only_by_force(splatree, small_ply, tmp_path):
    target = tmp_path / "out.ply"
    target.write_bytes(b"old")
    for verb in ("convert", "thin"):
        assert "exists already" in one_line(splatree(verb, small_ply, target))
        assert target.read_bytes() == b"old"
    assert splatree("convert", small_ply, target, "--force")[0] == 0
    assert target.read_bytes() == small_ply.read_bytes()


def test_existing_picture_is_replaced_only_by_force(splatree, small_ply, tmp_path):
    words = ("render", small_ply, "-o", tmp_path, "--views", "1", "--width", "20", "--height", "20")
    assert splatree(*words)[0] == 0
    assert "view_0000.png" in one_line(splatree(*words))
    assert splatree(*words, "--force")[0] == 0
    counters = (*words[:2], "--counters", tmp_path, *words[4:])
    assert splatree(*counters)[0] == 0
    assert "view_0000.npz: exists already" in one_line(splatree(*counters))


def wrong_line(run):
    return one_line(run, wanted=2)


@pytest.mark.parametrize("verb", ["info", "convert", "thin", "build", "calibrate", "render", "eval"])
def test_something_to_read_must_be_named(splatree, tmp_path, verb):
    outputs = {"render": ["-o", tmp_path]}.get(verb, [])
    assert "found no path, wanted a" in wrong_line(splatree(verb, *outputs))


def test_output_must_be_named(splatree, small_ply, tmp_path):
    assert "wanted an input and an output" in wrong_line(splatree("build", small_ply))
    assert "is a folder" in wrong_line(splatree("build", small_ply, tmp_path))
    assert "is an input too" in wrong_line(splatree("convert", small_ply, small_ply, "--force"))
    assert "found an empty path" in wrong_line(splatree("info", ""))


def test_an_output_in_a_folder_of_inputs_is_not_read_again(splatree, small_ply, tmp_path):
    for name in ("a.ply", "b.ply"):
        (tmp_path / name).write_bytes(small_ply.read_bytes())
    words = ("convert", tmp_path, "-o", tmp_path / "whole.ply")
    assert splatree(*words)[0] == 0
    written = (tmp_path / "whole.ply").read_bytes()
    assert "whole.ply: is an input too" in wrong_line(splatree(*words, "--force"))
    assert "is an input too" in wrong_line(splatree("convert", tmp_path / "*.ply", tmp_path / "whole.ply", "--force"))
    assert (tmp_path / "whole.ply").read_bytes() == written


def test_unusable_output_is_refused_before_any_work(splatree, tmp_path):
    missing = tmp_path / "nothing.ply"  # an error about the output shows that nothing was read
    assert ".xyz" in wrong_line(splatree("convert", missing, tmp_path / "out.xyz"))
    assert "sh_palette" in wrong_line(splatree("convert", missing, tmp_path / "out.glb", "--sh-palette", "64"))
    assert "levels of detail" in wrong_line(splatree("build", missing, tmp_path / "out.ply"))
    for verb, name in (("build", "out"), ("refine", "out.xyz")):
        line = wrong_line(splatree(verb, missing, tmp_path / name))
        assert "wanted .splatree, .hier or .rad, as in out.splatree; " in line and ".spz" not in line
    assert "found 0, wanted 1 or more" in wrong_line(
        splatree("build", missing, tmp_path / "out.splatree", "--clusters", "0")
    )
    (tmp_path / "old.splatree").write_bytes(b"old")
    assert "--force" in one_line(splatree("build", missing, tmp_path / "old.splatree"))


@pytest.mark.parametrize("verb", ["build", "calibrate", "render", "eval"])
def test_missing_cameras_are_told_before_any_work(splatree, tmp_path, verb):
    words = {"render": ["-o", tmp_path / "frames"], "eval": []}.get(verb, ["-o", tmp_path / "out.splatree"])
    missing = (tmp_path / "nothing.ply", *words, "--cameras", tmp_path / "cameras.json")
    assert "cameras.json" in one_line(splatree(verb, *missing))


def test_options_that_contradict_each_other_are_a_wrong_line(splatree, small_ply, tmp_path):
    build = ("build", small_ply, tmp_path / "a.splatree")
    assert "--flat without --clusters" in wrong_line(splatree(*build, "--flat"))
    assert "contradict" in wrong_line(splatree(*build, "--flat", "--clusters", "9", "--levels", "file"))
    assert "found 2 inputs" in wrong_line(splatree("build", small_ply, *build[1:], "--levels", "file"))
    assert "--flat and radius, growth, which" in wrong_line(
        splatree(*build, "--flat", "--clusters", "9", "--radius", "1", "--growth", "3")
    )
    assert "pixel_size: found 0.1" in wrong_line(splatree(*build, "--pixel-size", "0.1", "--method", "radius"))
    assert "importance: found 'opacity'" in wrong_line(
        splatree("thin", *build[1:], "--keep", "0.5", "--importance", "opacity")
    )
    assert "depth: found -1" in wrong_line(
        splatree("convert", tmp_path / "gone.ply", tmp_path / "b.ply", "--depth", "-1")
    )
    assert "found no --data" in wrong_line(splatree("eval", small_ply, "--training", "--frames", "0"))
    assert "scale" in wrong_line(splatree("render", small_ply, "-o", tmp_path, "--scale", "0"))
    assert "wanted .mp4" in wrong_line(splatree("render", small_ply, "--video", tmp_path / "a.avi"))
    assert "frames a second" in wrong_line(splatree("render", small_ply, "--video", tmp_path / "a.mp4", "--fps", "0"))


def test_verbose_shows_steps_and_the_origin_of_an_error(splatree, small_ply, tmp_path):
    code, out, err = splatree("thin", small_ply, tmp_path / "out.ply", "--keep", "0.5", "--verbose", "--json")
    assert code == 0
    assert json.loads(out)["num_gaussians"] > 0
    assert "read small.ply: " in err
    code, _, err = splatree("info", tmp_path / "nothing.ply", "-v")
    assert code == 1
    assert "Traceback" in err


def test_quiet_prints_nothing(splatree, small_ply, tmp_path):
    assert splatree("convert", small_ply, tmp_path / "out.ply", "-q") == (0, "", "")


def test_bug_is_reported_in_one_line(splatree, small_ply, monkeypatch):
    monkeypatch.setattr("splatree.cli.info.describe", lambda scene: 1 / 0)
    assert "ZeroDivisionError" in one_line(splatree("info", small_ply))


def test_installed_command_runs_and_reads_no_standard_input(small_ply):
    run = subprocess.run(
        [*COMMAND, "info", small_ply, "--json"], capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["num_gaussians"] == 3161


def test_a_plain_verb_loads_and_starts_nothing_that_it_does_not_need(small_ply, tmp_path):
    """What tyro would check defaults with, and threads of linear algebra, took a third of the start."""
    unneeded = (
        "typeguard",
        "unittest",
        "asyncio",
        "ssl",
        "rich",
        "PIL",
        "splatree.io.formats.sog.reader",
        "splatree.io.formats.glb.reader",
    )
    code = (
        "import sys; from pathlib import Path; from splatree.cli.main import main; assert main() == 0\n"
        f"print(*(name for name in {unneeded} if name in sys.modules))\n"
        "print(len(list(Path('/proc/self/task').iterdir())) if sys.platform == 'linux' else 1)"
    )
    few = tmp_path / "few.ply"
    write(Scene.flat(read(small_ply).gaussians.take([0, 1, 2])), few)  # too few for the kernels to take a second thread
    words = [sys.executable, "-c", code, "convert", few, tmp_path / "out.ply", "--quiet"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["", "1"], done


@pytest.mark.parametrize(
    "words",
    [
        ("--rotate", "1", "2", "3", "--crop-box", "0", "0", "0", "1", "1", "1"),
        ("--rotate", "1", "2"),
        ("--rotate", "1", "2", "east"),
        ("--order", "random"),
        ("--output",),
    ],
)
def test_a_line_means_the_same_whether_defaults_are_checked(splatree, small_ply, tmp_path, words, monkeypatch):
    found = []
    for is_checked in (False, True):
        with monkeypatch.context() as patch:
            if is_checked:
                patch.setitem(sys.modules, "typeguard", pytest.importorskip("typeguard"))
            else:
                patch.delitem(sys.modules, "typeguard", raising=False)
            found.append(splatree("convert", small_ply, tmp_path / "out.ply", "--force", *words))
    assert found[0] == found[1]


def test_reader_that_leaves_early_is_no_error(small_ply):
    with subprocess.Popen([*COMMAND, "info", small_ply], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        assert run.stderr.read() == b""
        assert run.wait() == 0


@pytest.mark.parametrize("words", [("--help",), ("info", "--help"), ("bench", "--help"), ("formats", "--json")])
def test_help_may_be_left_early_too(words):
    with subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        assert run.stderr.read() == b""
        assert run.wait() == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", [("--version",), ("info", "--help"), ("formats",)])
def test_output_that_cannot_be_written_is_an_error_in_one_line(words):
    with Path("/dev/full").open("w") as full:
        run = subprocess.run([*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True)
    assert run.returncode == 1
    assert run.stderr == "splatree: error: standard output: could not be written (No space left on device)\n"


@pytest.mark.skipif(sys.platform == "win32", reason="closes descriptors as a shell does")
def test_nothing_to_print_to_is_no_error(small_ply):
    line = f"{shlex.join(COMMAND)} info {small_ply} >&-"
    run = subprocess.run(["sh", "-c", line], stderr=subprocess.PIPE, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    line = f"{shlex.join(COMMAND)} info nothing.ply 2>&-"
    run = subprocess.run(["sh", "-c", line], stdout=subprocess.PIPE, text=True)
    assert (run.returncode, run.stdout) == (1, "")


def test_interrupt_while_a_verb_is_loaded_is_told_in_one_line(splatree, monkeypatch):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr("importlib.import_module", interrupted)
    assert splatree("info", "x.ply") == (130, "", "splatree: interrupted\n")


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT as a terminal does")
def test_interrupt_leaves_no_half_files(small_ply, tmp_path):
    words = ["render", small_ply, "-o", tmp_path, "--views", "500", "--width", "40", "--height", "30"]
    # A process started in the background of a shell inherits an ignored SIGINT; a terminal's does not.
    listening = "import signal, sys; from splatree.cli.main import main; signal.signal(2, signal.default_int_handler); "
    command = [sys.executable, "-c", listening + "sys.exit(main())", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        try:
            while not list(tmp_path.glob("*.png")) and run.poll() is None:
                time.sleep(0.02)
            run.send_signal(signal.SIGINT)
            _, err = run.communicate(timeout=60)
        finally:
            run.kill()
    assert run.returncode == 130
    assert err == "splatree: interrupted\n"
    assert all(path.suffix == ".png" and not path.name.startswith(".") for path in tmp_path.iterdir())
