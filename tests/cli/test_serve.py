import os
import signal
import subprocess
import sys
import urllib.request

from .conftest import listen_to_interruptions


def test_serve_says_its_address_and_answers_until_it_is_interrupted(splatree, small_tree, tmp_path):
    assert splatree("stream", small_tree, tmp_path / "out", "--levels", "2")[0] == 0
    words = [sys.executable, "-m", "splatree", "serve", str(tmp_path / "out"), "--port", "0"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listen_to_interruptions
    ) as process:
        try:
            line = process.stderr.readline()
            address = line.split(" at ")[1].split()[0]
            link = process.stderr.readline().strip()
            assert link == f"{address}open/playcanvas?stream=lod-meta.json"
            with urllib.request.urlopen(f"{address}lod-meta.json", timeout=10) as answer:
                assert answer.status == 200
            os.kill(process.pid, signal.SIGINT)
            out, _ = process.communicate(timeout=20)
            assert process.returncode == 0 and "served 1 stream at" in out
        finally:
            process.kill()


def test_ctrl_c_while_it_says_its_address_is_the_usual_end_too(splatree, small_tree, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    assert splatree("stream", small_tree, tmp_path / "out", "--levels", "2")[0] == 0
    monkeypatch.setattr("splatree.cli.serve._announce", interrupt)
    code, out, _ = splatree("serve", tmp_path / "out", "--port", "0")
    assert code == 0 and "served 1 stream at" in out


def test_a_folder_without_a_stream_is_refused(splatree, tmp_path):
    code, _, err = splatree("serve", tmp_path, "--port", "0")
    assert code == 1 and "write a stream with splatree stream" in err
