import tempfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.kernels.cpu.codec import columns as cpu
from splatree.kernels.reference import columns as reference

SCALARS = ["<i1", "<u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8"]


@given(st.lists(st.sampled_from(SCALARS), min_size=1, max_size=12), st.sampled_from([0, 1, 5, 1025, 9000]), st.data())
def test_deinterleave_is_the_reference_for_any_record(kinds, num_rows, draw):
    rng = np.random.default_rng(num_rows)
    names = [f"p{i}" for i in range(len(kinds))]
    records = np.zeros(num_rows, list(zip(names, kinds, strict=True)))
    for name in names:
        records[name] = rng.integers(0, 120, num_rows)
    order = draw.draw(st.permutations(names))
    fields = [order[:2], order[2:5]] if len(order) > 2 else [order]
    check_against_reference(records, fields)


@pytest.mark.parametrize("per_channel", [0, 3, 8, 15])
@pytest.mark.parametrize("order", ["channels", "reversed"])
def test_the_layouts_of_a_ply_are_the_reference(per_channel, order):
    names = [f"p{i}" for i in range(14 + 3 * per_channel)]
    records = (
        np.random.default_rng(0).standard_normal(3000 * len(names)).astype("<f4").view([(n, "<f4") for n in names])
    )
    rest = [names[3 + channel * per_channel + j] for j in range(per_channel) for channel in range(3)]
    sh = [*names[:3], *rest] if order == "channels" else [*names[2::-1], *rest[::-1]]
    tail = names[3 + 3 * per_channel :]
    fields = [sh, tail[:3], tail[3:7], tail[7:8], tail[8:]]
    check_against_reference(records, fields)
    columns = [np.stack([records[name] for name in names], axis=1) for names in fields[:4]]  # the last keep their bytes
    found, wanted = np.full_like(records, 7), np.full_like(records, 7)
    cpu.interleave([column[:2999] for column in columns], fields[:4], found, threads=2)
    reference.interleave([column[:2999] for column in columns], fields[:4], wanted)
    assert found.tobytes() == wanted.tobytes()


def test_interleave_writes_floats_within_its_records_only():
    column = np.zeros((3, 1), np.float32)
    with pytest.raises(ValueError, match="too few records"):
        cpu.interleave([column], [["a"]], np.zeros(2, [("a", "<f4")]))
    with pytest.raises(ValueError, match="wanted floats"):
        cpu.interleave([column], [["a"]], np.zeros(3, [("a", "<f8")]))


def check_against_reference(records, fields):
    with tempfile.TemporaryFile() as file:
        file.write(b"header" + records.tobytes())
        file.flush()
        found, wanted = ([np.full((len(records), len(f)), -1, np.float32) for f in fields] for _ in range(2))
        magnitudes = cpu.deinterleave(file, 6, records.dtype, fields, found, threads=2)
        assert magnitudes == reference.deinterleave(file, 6, records.dtype, fields, wanted)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kernel", [cpu, reference], ids=["cpu", "reference"])
def test_a_file_that_ends_early_is_an_error(kernel):
    record = np.dtype([("x", "<f4"), ("y", "<f4")])
    with tempfile.TemporaryFile() as file:
        file.write(bytes(8 * 99_999 + 7))
        file.flush()
        with pytest.raises(EOFError, match="ends before its last record"):
            kernel.deinterleave(file, 0, record, [["x"]], [np.empty((100_000, 1), np.float32)])


def test_an_error_of_the_system_is_passed_on(tmp_path):
    with (
        (tmp_path / "a").open("wb") as file,
        pytest.raises(OSError, match="Bad file descriptor"),
    ):  # open for writing only
        cpu.deinterleave(file, 0, np.dtype([("x", "<f4")]), [["x"]], [np.empty((9, 1), np.float32)])


def test_a_column_outside_of_the_record_is_refused(tmp_path):
    out = np.zeros((2, 1), np.float32)
    with tempfile.TemporaryFile() as file:
        for start, stride, offset in ((0, 8, -1), (0, 8, 5), (0, 8, 2**40), (-1, 8, 0), (0, 0, 0), (0, 2**40, 0)):
            with pytest.raises(ValueError, match=r"columns: |deinterleave: "):
                cpu._core.deinterleave(
                    file.fileno(), start, stride, np.array([offset]), np.array([6], np.uint8), [out], 1
                )


@given(st.lists(st.floats(width=32), max_size=40), st.integers(0, 2))
def test_largest_magnitude_is_the_reference(values, threads):
    array = np.array(values, np.float32)
    np.testing.assert_equal(
        cpu.largest_magnitude(array, threads=threads), reference.largest_magnitude(array, threads=threads)
    )


@pytest.mark.parametrize("value", [np.nan, -np.inf, -1e30])
def test_largest_magnitude_finds_one_value_anywhere_in_a_long_column(value):
    array = np.ones((1 << 18) + 77, np.float32)
    for row in (0, 1 << 18, len(array) - 1):
        array[row] = value
        np.testing.assert_equal(cpu.largest_magnitude(array), float(np.abs(np.float32(value))))
        array[row] = 1
