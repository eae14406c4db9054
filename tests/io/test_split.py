import numpy as np
import pytest

from splatree import Camera, FormatError, InputError
from splatree.io.cameras.split import split_views


def views(*names):
    return [Camera(np.eye(4), np.eye(3), 2, 2, name=name) for name in names]


CAMERAS = views(*(f"day/{i:02}.jpg" for i in range(20)))


def test_every_eighth_view_from_the_first_is_held_out():
    split = split_views(CAMERAS, 8)
    assert [camera.name for camera in split.held_out] == ["day/00.jpg", "day/08.jpg", "day/16.jpg"]
    assert len(split.training) == 17
    assert not {c.name for c in split.held_out} & {c.name for c in split.training}
    assert split.rule == "every 8th view from the first: 3 of 20"


def test_a_list_names_views_with_or_without_folder_and_suffix(tmp_path):
    listed = tmp_path / "test.txt"
    listed.write_text("# held out\nday/03.jpg\n\n07\n")
    split = split_views(CAMERAS, listed)
    assert [camera.name for camera in split.held_out] == ["day/03.jpg", "day/07.jpg"]
    assert split.rule == "the views listed in test.txt: 2 of 20"


def test_lists_that_do_not_fit_are_refused(tmp_path):
    listed = tmp_path / "test.txt"
    for text, error, match in (
        ("20", InputError, "'20' is the name of 0 cameras"),
        ("a", InputError, "'a' is the name of 2 cameras"),
        ("# nothing\n", FormatError, "found no name"),
    ):
        listed.write_text(text)
        with pytest.raises(error, match=match):
            split_views([*CAMERAS, *views("x/a.jpg", "y/a.png")], listed)
    for path in (tmp_path / "none.txt", tmp_path):
        with pytest.raises(InputError, match="found no such file, wanted a list of the held-out views"):
            split_views(CAMERAS, path)
    with pytest.raises(InputError, match="found 0"):
        split_views(CAMERAS, 0)


@pytest.mark.parametrize(
    ("n", "words"),
    [(1, "all views"), (2, "every 2nd view"), (3, "every 3rd view"), (11, "every 11th view"), (21, "every 21st view")],
)
def test_the_rule_is_said_in_words(n, words):
    assert split_views(CAMERAS, n).rule.startswith(words)
