import json
import struct

import numpy as np
import pytest

from splatree.errors import InputError
from splatree.view.messages import Ack, pack_message, parse

CENTRE = np.array([1e6, -2e6, 30.0])
VIEW = {
    "want": "cut",
    "seq": 3,
    "c2w": [1, 0, 0, 5, 0, 1, 0, 6, 0, 0, 1, -7],
    "f": 500,
    "w": 640,
    "h": 360,
    "tau": 3,
    "budget": 50_000,
}


def test_a_view_comes_in_world_coordinates():
    found = parse(json.dumps(VIEW), CENTRE)
    np.testing.assert_allclose(found.camera.position, CENTRE + [5, 6, -7])
    assert (found.want, found.seq, found.select.budget, found.select.pixel_error) == ("cut", 3, 50_000, 3)
    assert (found.camera.width, found.camera.height, found.camera.K[0, 0]) == (640, 360, 500)


def test_a_quality_goes_before_a_pixel_error():
    found = parse(json.dumps({**VIEW, "db": 40}), CENTRE).select
    assert (found.quality, found.budget) == (40, 50_000)
    assert parse(json.dumps({**VIEW, "db": None}), CENTRE).select.quality is None


def test_an_acknowledgement_is_a_count():
    assert parse('{"ack": 7}', CENTRE) == Ack(7)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"want": "files"}, "want: found 'files', wanted one of cut"),
        ({"w": 32_768, "h": 32_768}, "found a picture of 32768 × 32768 px"),
        ({"w": 0}, "w: found '0', wanted a number from 1"),
        ({"w": True}, "w: found 'True'"),
        ({"w": None}, "w: found 'None'"),
        ({"budget": 10**9}, "budget: found"),
        ({"tau": -1}, "tau: found '-1'"),
        ({"f": float("nan")}, "f: found 'nan'"),
        ({"f": "500"}, "f: found '500'"),
        ({"c2w": [1] * 11}, "c2w: wanted 12 numbers"),
        ({"c2w": [1] * 11 + [float("inf")]}, "c2w: found 'inf'"),
        (
            {"c2w": [1] * 11 + [10**400]},
            "c2w: found '1000000000000000000000000000000000000000', wanted numbers of at most",
        ),
        ({"c2w": [1, 1, 1, 0] * 3}, "not orthonormal"),
        ({"c2w": {"0": 1}}, "c2w: wanted 12 numbers"),
        ({"db": 61}, "db: found '61', wanted a number from 20 to 60"),
        ({"quality": 101}, "quality: found"),
        ({"packing": "exe"}, "packing: found 'exe'"),
        ({"box": [0] * 5}, "box: wanted 6 numbers"),
        ({"at": [1, "x"]}, "at: found 'x'"),
        ({"seq": -1}, "seq: found"),
    ],
)
def test_what_no_page_sends_is_refused(change, says):
    with pytest.raises(InputError, match=says):
        parse(json.dumps({**VIEW, **change}), CENTRE)


@pytest.mark.parametrize("text", ["", "[]", "3", "{", "[" * 60_000, "null", '"x"', "{}"])
def test_other_texts_are_refused(text):
    with pytest.raises(InputError):
        parse(text, CENTRE)


def test_a_long_text_is_refused_before_it_is_read():
    with pytest.raises(InputError, match="found 70,000 characters"):
        parse(" " * 70_000, CENTRE)


def test_the_payload_begins_at_a_multiple_of_four():
    for name in ("a", "ab", "abc", "abcd"):
        message = pack_message({"kind": name}, b"payload")
        (length,) = struct.unpack("<I", message[:4])
        assert length % 4 == 0
        assert json.loads(message[4 : 4 + length]) == {"kind": name}
        assert message[4 + length :] == b"payload"
