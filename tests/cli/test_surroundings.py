"""The program in bad surroundings: narrow consoles, closed streams, interruption at any time, a folder that is gone."""

import json
import os
import random
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import splatree
from splatree.cli.plain import SPELLED, printable

COMMAND = [sys.executable, "-m", "splatree"]
UNIX = pytest.mark.skipif(sys.platform == "win32", reason="signals, links and descriptors as on Unix")


def environment(encoding):
    return {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}


def clean(text):
    return "Traceback" not in text and "Exception ignored" not in text


@pytest.mark.parametrize("encoding", ["ascii", "cp437", "cp1252", "latin-1"])
def test_console_that_is_not_utf_8_is_written_to(small_ply, tmp_path, encoding):
    words = [*COMMAND, "build", small_ply, tmp_path / "Größe_τ.splatree", "--verbose"]
    run = subprocess.run(words, capture_output=True, env=environment(encoding))
    out, err = run.stdout.decode(encoding), run.stderr.decode(encoding)
    assert run.returncode == 0 and clean(err), err
    assert "wrote " in out and (tmp_path / "Größe_τ.splatree").is_file()
    shown = subprocess.run([*COMMAND, "info", small_ply], capture_output=True, env=environment(encoding), check=True)
    assert ("τ = " if encoding == "cp437" else "tau = ") in shown.stdout.decode(encoding)


def test_json_on_an_ascii_console_loses_nothing(small_ply, tmp_path):
    target = tmp_path / "Größe_τ.ply"
    target.write_bytes(small_ply.read_bytes())
    words = [*COMMAND, "info", target, "--json"]
    run = subprocess.run(words, capture_output=True, env=environment("ascii"), check=True)
    assert json.loads(run.stdout.decode("ascii"))["paths"] == [str(target)]


def test_help_is_shown_on_an_ascii_console():
    for verb in ("render", "calibrate"):
        words = [*COMMAND, verb, "--help"]
        run = subprocess.run(words, capture_output=True, env=environment("ascii"), check=True)
        assert "--json" in run.stdout.decode("ascii") and clean(run.stderr.decode("ascii"))


def test_what_a_console_lacks_is_spelled_out():
    class Stream:
        encoding = "ascii"

    assert printable("τ = 2 × 10⁴ ≤ √9", Stream) == "tau = 2 x 10^4 <= sqrt 9"
    assert printable("日本", Stream) == "??"
    assert all(value.isascii() for value in SPELLED.values())


@UNIX
@pytest.mark.parametrize("closed", ["2>&-", ">&-", ">&- 2>&-", "<&-", "2>/dev/full"])
def test_closed_streams_stop_no_work(small_ply, tmp_path, closed):
    for flags in ("", "--verbose --json"):
        target = tmp_path / f"out{len(flags)}.ply"
        line = f"{shlex.join(COMMAND)} convert {small_ply} {target} {flags} {closed}"
        run = subprocess.run(["sh", "-c", line], capture_output=True, text=True)
        assert run.returncode == 0 and clean(run.stderr), run.stderr
        assert target.is_file()


@UNIX
def test_interruption_at_any_time_is_one_line(small_ply, tmp_path):
    """At 8 times between the start of the program and its end."""
    begin = time.perf_counter()
    subprocess.run([*COMMAND, "info", small_ply], capture_output=True, check=True)
    whole = time.perf_counter() - begin
    generator = random.Random(1)
    seen = set()
    for i in range(8):
        with subprocess.Popen([*COMMAND, "info", small_ply], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
            time.sleep(whole * (0.15 + 0.9 * i / 8 + 0.02 * generator.random()))
            run.send_signal(signal.SIGINT)
            _, err = run.communicate()
        said = err.decode()
        seen.add(run.returncode)
        # Before the program's first line runs, Python itself is interrupted: by its own words, or by the signal.
        from_python = "splatree" not in said and run.returncode in (1, 130, -signal.SIGINT)
        assert run.returncode == 0 or said == "splatree: interrupted\n" or from_python, said
    assert seen & {130, 0}


@UNIX
def test_interruption_while_the_program_is_loaded_is_one_line(tmp_path):
    """The module that the program loads first is interrupted by itself."""
    code = (
        "import sys, signal, os\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == sys.argv[1]: os.kill(os.getpid(), signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from splatree.cli.start import main\n"
        "name, sys.argv = sys.argv[1], ['splatree', 'info', 'x.ply']\n"
        "Interrupt.find_spec = lambda self, found, path=None, target=None, name=name: (\n"
        "    os.kill(os.getpid(), signal.SIGINT) if found == name else None)\n"
        "sys.exit(main())\n"
    )
    for module in ("splatree.cli.main", "splatree.cli.info", "tyro", "numpy"):
        run = subprocess.run([sys.executable, "-c", code, module], capture_output=True, text=True)
        assert (run.returncode, run.stderr) == (130, "splatree: interrupted\n"), (module, run.stderr)


@UNIX
def test_links_in_a_circle_are_one_line(splatree, small_ply, tmp_path):
    (tmp_path / "a.ply").symlink_to(tmp_path / "b.ply")
    (tmp_path / "b.ply").symlink_to(tmp_path / "a.ply")
    for words in (("info", tmp_path / "a.ply"), ("convert", small_ply, tmp_path / "a.ply")):
        code, _, err = splatree(*words)
        assert code == 1 and err.count("\n") == 1 and "a.ply" in err, err
    code, _, err = splatree("render", small_ply, "-o", tmp_path / "a.ply" / "b")
    assert code == 1 and err.count("\n") == 1, err


@UNIX
@pytest.mark.parametrize("words", ["info x.ply", "convert SMALL out.ply", "render SMALL", "build SMALL a.splatree"])
def test_working_folder_that_is_gone_is_one_line(small_ply, tmp_path, words):
    (tmp_path / "gone").mkdir()
    line = (
        f"cd {tmp_path}/gone && rmdir {tmp_path}/gone && {shlex.join(COMMAND)} {words.replace('SMALL', str(small_ply))}"
    )
    sources = str(Path(splatree.__file__).parent.parent)
    run = subprocess.run(["sh", "-c", line], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": sources})
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1 and run.stderr.startswith("splatree "), run.stderr
