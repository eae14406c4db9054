import importlib.util
import subprocess
import sys

import numpy as np
import pytest

from splatree.errors import InputError, MissingExtraError, OutputError
from splatree.render.video import open_video

needs_ffmpeg = pytest.mark.skipif(
    importlib.util.find_spec("imageio_ffmpeg") is None, reason="imageio-ffmpeg (extra video) is not installed"
)


def pictures(count=5, height=31, width=48):
    """A grey that brightens from frame to frame, to white."""
    return [np.full((height, width, 3), 0.2 * (i + 1), np.float32) for i in range(count)]


@needs_ffmpeg
def test_video_holds_its_frames(tmp_path):
    import imageio_ffmpeg

    with open_video(tmp_path / "out.mp4", fps=10) as add:
        for image in pictures():
            add(image)
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", tmp_path / "out.mp4"]
    raw = subprocess.run([*decode, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, 32, 48, 3)  # the odd edge was repeated
    # H.264 at this quality keeps a flat grey within two of 255 steps.
    assert frames.mean(axis=(1, 2, 3)) == pytest.approx([255 * 0.2 * (i + 1) for i in range(5)], abs=2)
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]


@needs_ffmpeg
def test_interrupted_video_leaves_the_old_file(tmp_path):
    (tmp_path / "out.mp4").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), open_video(tmp_path / "out.mp4", force=True) as add:
        add(pictures()[0])
        raise KeyboardInterrupt
    assert (tmp_path / "out.mp4").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]


@needs_ffmpeg
def test_old_video_is_replaced_only_by_force(tmp_path):
    (tmp_path / "out.mp4").write_bytes(b"old")
    with pytest.raises(OutputError, match="exists"), open_video(tmp_path / "out.mp4"):
        pass
    with open_video(tmp_path / "out.mp4", force=True) as add:
        add(pictures()[0])
    assert (tmp_path / "out.mp4").stat().st_size > 100


@needs_ffmpeg
def test_video_into_a_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="no folder"), open_video(tmp_path / "none" / "out.mp4"):
        pass


@needs_ffmpeg
def test_failing_encoder_is_an_output_error(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[open_video.__module__], "CRF", "nonsense")
    with pytest.raises(OutputError, match="ffmpeg stopped"), open_video(tmp_path / "out.mp4") as add:
        for image in pictures(100):
            add(image)
    assert list(tmp_path.iterdir()) == []


@needs_ffmpeg
def test_pictures_of_two_sizes_and_no_pictures_are_refused(tmp_path):
    with pytest.raises(InputError, match="equal sizes"), open_video(tmp_path / "out.mp4") as add:
        add(pictures()[0])
        add(pictures(height=64)[0])
    with pytest.raises(InputError, match="no pictures"), open_video(tmp_path / "out.mp4"):
        pass


def test_other_containers_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"wanted \.mp4"), open_video(tmp_path / "out.gif"):
        pass


def test_missing_ffmpeg_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'splatree\[video\]'"), open_video(tmp_path / "out.mp4"):
        pass


@needs_ffmpeg
@pytest.mark.parametrize(("height", "width"), [(32, 48), (31, 48), (32, 47), (31, 47)])
def test_an_odd_edge_is_repeated_and_every_other_pixel_stays_in_its_place(tmp_path, height, width):
    import imageio_ffmpeg

    down, across = np.mgrid[0:height, 0:width]
    image = np.repeat((0.1 + down / 80 + across / 120)[..., None], 3, axis=2).astype(np.float32)
    with open_video(tmp_path / "out.mp4") as add:
        for _ in range(3):
            add(image)
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", tmp_path / "out.mp4"]
    raw = subprocess.run([*decode, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(3, height + height % 2, width + width % 2, 3)
    wanted = 255 * np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    # H.264 at this quality keeps a smooth ramp within a few of 255 steps; rows of a wrong length would shear it by 100.
    assert np.abs(frames - wanted[None]).max() <= 8
