import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree.kernels.cpu.codec import quantize as cpu
from splatree.kernels.reference import quantize as reference

SIGNS = np.array([1, -1, 1, -1], np.float32)


def away_from_steps(values, distance=1e-3):
    """Where a number is not within ``distance`` of a half, at which rounding may fall either way."""
    return np.abs(values - np.floor(values) - 0.5) > distance


def quats_like(n, seed=0):
    return np.random.default_rng(seed).standard_normal((n, 4)).astype(np.float32)


@pytest.mark.parametrize("n", [0, 1, 17, 9001])
@pytest.mark.parametrize(("width", "stride", "skip"), [(3, 3, 0), (3, 48, 0), (9, 12, 3), (24, 27, 3), (45, 48, 3)])
def test_bytes_are_the_nearest_codes(isa, n, width, stride, skip):
    rng = np.random.default_rng(n)
    values = rng.standard_normal((n, stride)).astype(np.float32)
    scale = rng.uniform(-200, 200, width).astype(np.float32)
    found, wanted = np.zeros((2, n, width), np.uint8)
    step = 2 ** rng.integers(0, 5, width)
    cpu.bytes_from_values(values, found, scale=scale, offset=127.5, step=step, skip=skip)
    reference.bytes_from_values(values, wanted, scale=scale, offset=127.5, step=step, skip=skip)
    clear = away_from_steps(values[:, skip : skip + width].astype(np.float64) * scale + 127.5)
    np.testing.assert_array_equal(found[clear], wanted[clear])
    assert (np.abs(found.astype(int) - wanted) <= step).all()


@pytest.mark.parametrize("bits", range(1, 9))
def test_harmonics_have_the_codes_of_the_format_bit_for_bit(isa, bits):
    """The products with 128 are exact, so no rounding step can fall two ways but where ½ itself is hit."""
    values = np.linspace(-1.2, 1.2, 4500, dtype=np.float32).reshape(-1, 45)
    found, wanted = np.zeros((2, *values.shape), np.uint8)
    for kernel, codes in ((cpu, found), (reference, wanted)):
        kernel.bytes_from_values(values, codes, scale=128, offset=128, step=1 << 8 - bits)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("width", "stride", "skip"), [(3, 3, 0), (3, 48, 0), (9, 12, 3), (24, 27, 3), (45, 48, 3)])
def test_values_come_back_beside_what_is_skipped(isa, width, stride, skip):
    codes = np.random.default_rng(0).integers(0, 256, (300, width), dtype=np.uint8)
    found, wanted = np.full((2, 300, stride), 7, np.float32)
    for kernel, values in ((cpu, found), (reference, wanted)):
        kernel.values_from_bytes(codes, values, scale=1 / 128, offset=-1, skip=skip)
    np.testing.assert_array_equal(found, wanted)


def test_opacities_are_rounded_to_the_nearest_byte(isa):
    logits = np.linspace(-200, 200, 20011, dtype=np.float32)
    found, wanted = np.zeros((2, len(logits)), np.uint8)
    cpu.bytes_from_logits(logits, found)
    reference.bytes_from_logits(logits, wanted)
    clear = away_from_steps(
        255 / (1 + np.exp(-logits.astype(np.float64)))
    )  # 255 × 2e-7 of the exponential is well below
    np.testing.assert_array_equal(found[clear], wanted[clear])


@given(st.integers(0, 23), st.sampled_from([0, 1, 5, 1000]))
def test_fixed_point_is_the_reference_bit_for_bit_and_comes_back(bits, n):
    scale = 2.0**bits
    largest = (2**23 - 1) / scale
    means = np.random.default_rng(n).uniform(-largest, largest, (n, 3)).astype(np.float32)
    found, wanted = np.zeros((2, n, 9), np.uint8)
    cpu.fixed_from_means(means, found, signs=SIGNS[:3], scale=scale)
    reference.fixed_from_means(means, wanted, signs=SIGNS[:3], scale=scale)
    np.testing.assert_array_equal(found, wanted)
    back, there = np.zeros((2, n, 3), np.float32)
    cpu.means_from_fixed(found, back, scale=1 / scale)
    reference.means_from_fixed(found, there, scale=1 / scale)
    np.testing.assert_array_equal(back, there)
    assert (np.abs(back * SIGNS[:3] - means) <= 0.5 / scale).all()


@pytest.mark.parametrize("num_bytes", [3, 4])
@pytest.mark.parametrize("n", [1, 15, 16, 40, 5003])
def test_rotations_are_the_reference(isa, num_bytes, n):
    quats = quats_like(n) * np.float32(10.0) ** np.random.default_rng(1).integers(-10, 10, (n, 1)).astype(np.float32)
    found, wanted = np.zeros((2, n, num_bytes), np.uint8)
    cpu.codes_from_quats(quats, found, signs=SIGNS)
    reference.codes_from_quats(quats, wanted, signs=SIGNS)
    same = (found == wanted).all(axis=1)
    assert same.mean() > 0.99 or n < 100  # a component on a step may be rounded either way
    back, there = np.zeros((2, n, 4), np.float32)
    cpu.quats_from_codes(found, back)
    reference.quats_from_codes(found, there)
    # The largest component is a square root: near 0 of a 3-byte code, 1e-7 under it is 3e-4.
    np.testing.assert_allclose(back, there, atol=1e-6 if num_bytes == 4 else 1e-3)
    reference.quats_from_codes(wanted, there)
    unit = quats * SIGNS / np.linalg.norm(quats, axis=1, keepdims=True)
    turned = np.abs((there * unit).sum(axis=1)) / np.linalg.norm(there, axis=1)
    angles = np.degrees(2 * np.arccos(np.minimum(turned, 1)))
    assert angles.max() < (0.25 if num_bytes == 4 else 12.1)


@pytest.mark.parametrize("quat", [(0, 0, 0, 1), (-1, 0, 0, 0), (1, 1, 1, 1), (-1, 1, -1, 1), (0, 0, -3, 3)])
def test_equal_components_take_the_first_place(isa, quat):
    quats = np.array([quat], np.float32)
    found, wanted = np.zeros((2, 1, 4), np.uint8)
    cpu.codes_from_quats(quats, found, signs=np.abs(SIGNS))
    reference.codes_from_quats(quats, wanted, signs=np.abs(SIGNS))
    np.testing.assert_array_equal(found, wanted)


def test_codes_do_not_depend_on_threads_or_on_the_place_of_a_row(isa):
    quats, logits = quats_like(10_000), quats_like(2500).reshape(-1)
    for kernel, values, shape in ((cpu.codes_from_quats, quats, (4,)), (cpu.bytes_from_logits, logits, ())):
        options = {"signs": SIGNS} if shape else {}
        one, many, late = np.zeros((3, 10_000, *shape), np.uint8)
        kernel(values, one, threads=1, **options)
        kernel(values, many, threads=4, **options)
        kernel(np.ascontiguousarray(values[5:]), late[5:], **options)
        np.testing.assert_array_equal(one, many)
        np.testing.assert_array_equal(one[5:], late[5:])
