"""JSON from outside: what is taken, and what each error names."""

import json

import numpy as np
import pytest

from splatree import FormatError
from splatree.io import untrusted


@pytest.mark.parametrize("value", [0, 7, 7.0, 2**31 - 1])
def test_whole_numbers_are_taken_even_as_floats(value):
    found = untrusted.integer({"n": value}, "n", "a.json")
    assert found == value and isinstance(found, int)


@pytest.mark.parametrize("value", [-1, 2**31, 0.5, True, False, "1", None, [1], float("nan"), float("inf")])
def test_what_is_no_whole_number_in_the_range_is_refused(value):
    with pytest.raises(FormatError, match=r"a\.json\.n: found .*, wanted a whole number from 0 to 2147483647"):
        untrusted.integer({"n": value}, "n", "a.json")


def test_the_ends_of_a_range_belong_to_it():
    assert [untrusted.as_integer(value, "", low=2, high=4) for value in (2, 3, 4)] == [2, 3, 4]
    for value in (1, 5):
        with pytest.raises(FormatError, match=f"found {value}, wanted a whole number from 2 to 4"):
            untrusted.as_integer(value, "", low=2, high=4)


@pytest.mark.parametrize(
    ("value", "kind"),
    [({}, "an object"), ([], "a list"), ("a", "a string"), (True, "a boolean"), (None, "null"), (1.5, "a number")],
)
def test_what_was_found_is_named(value, kind):
    for read, wanted in (
        (untrusted.as_object, "an object {…}"),
        (untrusted.as_list, "a list […]"),
        (untrusted.as_text, "a string"),
    ):
        if kind == wanted.split(" {")[0].split(" […")[0]:
            assert read(value, "here") is value
        else:
            with pytest.raises(FormatError) as error:
                read(value, "here")
            assert str(error.value) == f"here: found {kind}, wanted {wanted}"


def test_long_values_are_shortened_in_errors():
    for length, shown in ((78, repr("x" * 78)), (79, "'" + "x" * 76 + "...")):
        with pytest.raises(FormatError) as error:
            untrusted.as_integer("x" * length, "n")
        assert str(error.value).startswith(f"n: found {shown}, wanted")


def test_a_missing_key_names_those_that_are_there():
    record = {f"k{i:02d}": i for i in range(20)}
    with pytest.raises(FormatError) as error:
        untrusted.field(record, "gone", "a.json")
    assert str(error.value) == f"a.json: found no key 'gone', only {sorted(record)[:12]}"


def test_numbers_have_their_shape_and_are_finite():
    record = {"m": [[1, 2], [3, 4.5]], "ragged": [[1], [2, 3]], "nan": [float("nan")], "text": ["a"], "one": 3}
    np.testing.assert_array_equal(untrusted.numbers(record, "m", "here", (2, 2)), [[1, 2], [3, 4.5]])
    assert untrusted.number(record, "one", "here") == 3
    for key, shape, message in (
        ("m", (4,), r"found numbers of shape \(2, 2\), wanted \(4,\)"),
        ("ragged", (2, 2), "found a list that does not hold numbers only"),
        ("text", (1,), "found a list that does not hold numbers only"),
        ("nan", (1,), "found NaN or infinity"),
    ):
        with pytest.raises(FormatError, match=rf"here\.{key}: {message}"):
            untrusted.numbers(record, key, "here", shape)


def test_json_of_a_hostile_size_is_refused_unread(tmp_path, monkeypatch):
    (tmp_path / "a.json").write_text(json.dumps({"a": 1}))
    size = (tmp_path / "a.json").stat().st_size
    monkeypatch.setattr(untrusted, "MAX_JSON_BYTES", size)
    assert untrusted.read_json(tmp_path / "a.json") == {"a": 1}
    monkeypatch.setattr(untrusted, "MAX_JSON_BYTES", size - 1)
    with pytest.raises(FormatError, match=f"found {size} bytes of JSON, wanted at most {size - 1}"):
        untrusted.read_json(tmp_path / "a.json")


@pytest.mark.parametrize("text", ["{", "[" * 100_000, ""])
def test_what_is_not_json_is_one_error(text):
    with pytest.raises(FormatError, match=r"a\.json: "):
        untrusted.parse_json(text.encode(), "a.json")


@pytest.mark.parametrize("name", ["a", "a/b", "a\\b", "./a", "a..b"])
def test_names_inside_the_folder_are_taken(name):
    assert untrusted.inner_path(name, "") == name.replace("\\", "/")


@pytest.mark.parametrize("name", ["", "/a", "\\a", "..", "a/../../b", "a\\..\\..\\b", "c:a", "a//b", "a/", "a\0b"])
def test_names_that_may_lead_elsewhere_are_refused(name):
    with pytest.raises(FormatError, match="wanted a relative path inside the folder"):
        untrusted.inner_path(name, "")
