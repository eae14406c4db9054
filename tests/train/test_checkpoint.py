"""A run that stops goes on with the same bits, or says why it cannot."""

import errno
import json
import os

import numpy as np
import pytest

import splatree as st
from splatree.train import kept

from .test_run import bits

OPTIONS = st.TrainOptions(iterations=130, max_gaussians=260, held_out=4)


def stop_after(steps):
    """Ask to stop once this many steps were made."""
    left = iter(range(steps - 1, -1, -1))
    return lambda: next(left) == 0


def rewrite(path, change):
    """Change what a checkpoint says about itself."""
    with np.load(path) as stored:
        arrays = dict(stored)
    about = json.loads(arrays["about"].tobytes()) | change
    np.savez(path, **arrays | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)})


@pytest.fixture(scope="module")
def whole(kept_photographs):
    """A run that was not stopped."""
    return st.train(kept_photographs, OPTIONS)


@pytest.mark.parametrize("step", [1, 37, 100, 117])
def test_a_run_that_stopped_goes_on_with_the_same_bits(whole, photographs, tmp_path, step):
    """In the middle of a round, and right after births."""
    folder = tmp_path / "a.run"
    stopped = st.train(photographs, OPTIONS, files=st.RunFiles(folder), stop=stop_after(step))
    assert stopped.stopped and json.loads(stopped.scene.source.metadata["training"])["iterations"] == step
    resumed = st.train(photographs, OPTIONS, files=st.RunFiles(folder, resume=True))
    assert bits(resumed) == bits(whole) != bits(stopped)
    for name, exposure in whole.exposures.items():
        np.testing.assert_array_equal(resumed.exposures[name], exposure)
    assert resumed.log == whole.log
    assert [scored.score for scored in resumed.history] == [scored.score for scored in whole.history]


def test_a_run_that_ended_has_nothing_to_go_on_with(photographs, tmp_path):
    files = st.RunFiles(tmp_path / "a.run")
    options = st.TrainOptions(iterations=5, max_gaussians=260, held_out=4)
    first = st.train(photographs, options, files=files)
    again = st.train(photographs, options, files=st.RunFiles(tmp_path / "a.run", resume=True))
    assert bits(first) == bits(again) and len(again.history) == len(first.history)


def test_files_of_a_run_say_what_it_found(photographs, tmp_path):
    trained = st.train(photographs, OPTIONS, files=st.RunFiles(tmp_path / "a.run"))
    assert sorted(path.name for path in (tmp_path / "a.run").iterdir()) == [
        "checkpoint.npz",
        "exposure.json",
        "log.json",
    ]
    exposures = json.loads((tmp_path / "a.run" / "exposure.json").read_text())
    assert exposures == {name: exposure.tolist() for name, exposure in trained.exposures.items()}
    assert tuple(kept.read_log(tmp_path / "a.run" / "log.json")) == trained.log


@pytest.fixture
def begun(photographs, tmp_path):
    """A run that was stopped."""
    folder = tmp_path / "a.run"
    st.train(photographs, OPTIONS, files=st.RunFiles(folder), stop=stop_after(3))

    def go_on(options=OPTIONS):
        return st.train(photographs, options, files=st.RunFiles(folder, resume=True))

    return go_on


def test_changed_photographs_are_refused(begun, photographs):
    path = photographs / "images" / "photo_2.png"
    st.write_image(st.read_image(path) * 0.99, path, force=True)
    with pytest.raises(st.InputError, match=r"photograph 'photo_2.png' has changed, or its camera has"):
        begun()


def test_missing_photographs_and_other_cameras_are_refused(begun, photographs):
    images = photographs / "sparse" / "0" / "images.txt"
    text = images.read_text()
    images.write_text(text.replace(" 1 photo_3.png", " 1 photo_9.png"))
    with pytest.raises(st.InputError, match=r"photograph 'photo_3.png', with which the run was begun, is missing"):
        begun()
    lines = text.splitlines()
    words = lines[2].split()
    words[5] = "0.123"
    images.write_text("\n".join([*lines[:2], " ".join(words), *lines[3:]]) + "\n")
    with pytest.raises(st.InputError, match=r"photograph 'photo_1.png' has changed, or its camera has"):
        begun()


def test_other_options_are_refused_by_name(begun):
    with pytest.raises(st.InputError, match=r"begun with max_gaussians 260, found 270"):
        begun(st.TrainOptions(iterations=130, max_gaussians=270, held_out=4))
    begun(st.TrainOptions(iterations=130, max_gaussians=260, held_out=4, score=False))  # which changes no bit
    begun(st.TrainOptions(iterations=130, max_gaussians=260, held_out=4, levels="radius"))  # built after the last step
    with pytest.raises(st.InputError, match=r"begun with levels 'radius', found 'grow'"):
        begun(st.TrainOptions(iterations=130, max_gaussians=260, held_out=4, levels="grow"))


def test_damaged_checkpoints_are_refused(begun, tmp_path):
    path = tmp_path / "a.run" / "checkpoint.npz"
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"no archive", whole[:100] + b"x" * 4000 + whole[4100:]):
        path.write_bytes(damaged)
        with pytest.raises(st.FormatError, match=r"checkpoint.npz: not a whole checkpoint"):
            begun()
    path.unlink()
    with pytest.raises(st.InputError, match=r"checkpoint.npz: not found"):
        begun()


@pytest.mark.parametrize(("name", "value"), [("step", -5), ("step", "a"), ("spent_s", float("nan")), ("loss", None)])
def test_checkpoints_with_wrong_numbers_are_refused(begun, tmp_path, name, value):
    path = tmp_path / "a.run" / "checkpoint.npz"
    rewrite(path, {name: value})
    with pytest.raises(st.FormatError, match=rf"checkpoint.npz.{name}: found "):
        begun()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 2}, r"found version 2, wanted 3; begin the run again"),
        ({"command": "refine"}, r"found a run of refine, wanted one of train"),
    ],
)
def test_checkpoints_of_others_are_refused(begun, tmp_path, change, said):
    path = tmp_path / "a.run" / "checkpoint.npz"
    rewrite(path, change)
    with pytest.raises(st.InputError, match=said):
        begun()


@pytest.mark.parametrize("name", ["moments", "steps", "errors", "weights", "exposures", "visits"])
def test_checkpoints_of_other_rows_are_refused(begun, tmp_path, name):
    path = tmp_path / "a.run" / "checkpoint.npz"
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **arrays | {name: arrays[name][:-1]})
    with pytest.raises(st.FormatError, match=rf"checkpoint.npz: {name}: found shape .*, wanted"):
        begun()


def test_a_run_that_cannot_be_kept_is_refused_before_the_first_step(photographs, tmp_path):
    (tmp_path / "file").write_text("")
    steps = []
    for folder in (tmp_path / "none" / "a.run", tmp_path / "file"):
        with pytest.raises(st.OutputError, match=f"{folder.name}: cannot be made a folder for the run"):
            st.train(photographs, OPTIONS, files=st.RunFiles(folder), stop=lambda: bool(steps.append(1)))
    assert not steps


def test_a_full_disk_leaves_the_last_checkpoint_whole(begun, photographs, tmp_path, monkeypatch):
    path = tmp_path / "a.run" / "checkpoint.npz"
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half of it")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(st.OutputError, match=r"checkpoint.npz: could not be written \(No space left on device\)"):
            begun()
    assert path.read_bytes() == before
    assert sorted(entry.name for entry in path.parent.iterdir()) == ["checkpoint.npz", "exposure.json", "log.json"]
    assert begun().history[-1].iterations == 130


def test_logs_that_are_none_are_refused(photographs, tmp_path):
    path = tmp_path / "log.json"
    for text, words in (
        ("[]", "found no step"),
        ('[{"step": 5, "share": 0, "growth": 0, "num_steps": 3}]', "found its first step 5, wanted 0"),
        ('[{"step": 0}]', "no key"),
        ('[{"step": 0, "share": 0, "growth": -1, "num_steps": 3}]', "round 0: found share 0 and growth -1, wanted"),
        ('[{"step": 0, "share": 2, "growth": 0, "num_steps": 3}]', "round 0: found share 2 and growth 0, wanted"),
        ("{", "not valid JSON"),
    ):
        path.write_text(text)
        with pytest.raises(st.FormatError, match=words):
            st.train(photographs, OPTIONS, files=st.RunFiles(replay=path))
    with pytest.raises(st.InputError, match=r"not found; wanted log\.json"):
        st.train(photographs, OPTIONS, files=st.RunFiles(replay=tmp_path / "no.json"))
    with pytest.raises(st.InputError, match="found no folder of a run"):
        st.RunFiles(resume=True)
