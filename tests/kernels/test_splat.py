import numpy as np
import pytest

from splatree import Gaussians
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.codec import splat as cpu
from splatree.kernels.reference import splat as reference

from ..scenes import gaussians

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def hostile() -> Gaussians:
    """Limits of what is accepted, among them opacities without a code and scales of e^±30."""
    g = gaussians(40, 1)
    g.log_scales[:10] = np.array([30, -30, 0], np.float32)
    g.logit_opacities[:8] = [3e38, -3e38, 100, -100, 17, -17, 0, -0.0]
    g.sh[:4, 0] = [[1e6] * 3, [-1e6] * 3, [1.7724539] * 3, [-1.7724539] * 3]
    g.quats[:5] = [[1e-11, 0, 0, 0], [0, 1e12, 0, 0], [1, 1, 1, 1], [-1, -1, -1, -1], [0, 0, 0, -1]]
    return g


@pytest.mark.parametrize("make", [lambda: gaussians(9001, 0, degree=3), lambda: gaussians(1, 0, degree=0), hostile])
def test_records_are_the_reference(make):
    g = make()
    found, wanted = (np.zeros((len(g), 32), np.uint8) for _ in range(2))
    cpu.encode(g, found)
    reference.encode(g, wanted)
    a, b = (records.reshape(-1).view(reference.RECORD) for records in (found, wanted))
    np.testing.assert_array_equal(a["mean"], b["mean"])
    np.testing.assert_allclose(a["scale"], b["scale"], rtol=1.5e-7)  # the C library's exp is off by a bit at most
    for field in ("rgba", "quat"):  # steps: float32 may fall to the other side of a half, one time in thousands
        difference = np.abs(a[field].astype(int) - b[field])
        assert difference.max() <= 1 and difference.mean() < 1e-3


@pytest.mark.parametrize("make", [lambda: gaussians(1000, 0, degree=3), hostile])
def test_bytes_depend_on_neither_the_processor_nor_the_place_of_a_row(make, isa):
    g = make()
    wanted = splats_of(g, "v2" if "v2" in _core.isas() else isa)
    np.testing.assert_array_equal(splats_of(g, isa), wanted)
    np.testing.assert_array_equal(splats_of(g.rows(7, len(g)), isa), wanted[7:])


def splats_of(g, isa):
    """Records, and ranks behind them."""
    _core.use_isa(isa)
    records, ranks = np.zeros((len(g), 32), np.uint8), np.zeros(len(g), np.uint16)
    cpu.encode(g, records)
    cpu.ranks(g, ranks)
    return np.hstack([records, ranks[:, None].view(np.uint8)])


def test_encoding_finds_the_largest_dc():
    g = gaussians(200, 0, degree=2)
    g.sh[:, 1:] = 1e9
    records = np.zeros((200, 32), np.uint8)
    assert cpu.encode(g, records) == np.abs(g.sh[:, 0]).max()
    g.sh[70, 0, 2] = -1e7
    assert cpu.encode(g, records) == 1e7
    g.sh[3, 0, 1] = np.nan
    assert np.isnan(cpu.encode(g, records))


def test_records_of_one_rank_lie_together_in_their_order(tmp_path):
    rng = np.random.default_rng(0)
    records = rng.integers(0, 256, (500, 32)).astype(np.uint8)
    ranks = rng.choice(np.array([0, 3, 4, 4095], np.uint16), 500)
    counts = np.bincount(ranks, minlength=4096)
    places = np.cumsum(counts) - counts
    with (tmp_path / "a").open("wb") as file:
        for rows in (slice(0, 200), slice(200, 500)):
            cpu.place(records[rows], ranks[rows], places, file)
    found = np.fromfile(tmp_path / "a", np.uint8).reshape(-1, 32)
    np.testing.assert_array_equal(found, records[np.argsort(ranks, kind="stable")])
    np.testing.assert_array_equal(places, np.cumsum(counts))
    with (tmp_path / "a").open("rb") as file, pytest.raises(OSError, match="Bad file descriptor"):
        cpu.place(records, ranks, places, file)
    with (tmp_path / "b").open("wb") as file, pytest.raises(ValueError, match="no such rank"):
        cpu.place(records[:1], np.array([4096], np.uint16), places, file)


def test_decoded_records_are_the_reference():
    records = np.random.default_rng(0).integers(0, 256, (5000, 32)).astype(np.uint8)
    records[:, 15] = records[:, 19] = records[:, 23] = 0x3D  # scales near 0.05; some of the rest have no logarithm
    records[:40, 12:24] = 0
    found, wanted = (
        Gaussians(*(np.zeros((5000, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (1, 3)))) for _ in range(2)
    )
    cpu.decode(records, found, threads=2)
    reference.decode(records, wanted)
    for name in COLUMNS:
        # A rounding of float32 in the logarithm, in the colour's division by C0 two.
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=2.5e-7, atol=3e-7)


@pytest.mark.parametrize("make", [lambda: gaussians(9001, 0, degree=1), hostile])
def test_ranks_are_the_reference(make):
    g = make()
    found, wanted = (np.zeros(len(g), np.uint16) for _ in range(2))
    cpu.ranks(g, found)
    reference.ranks(g, wanted)
    found, wanted = found.astype(int), wanted.astype(int)
    # A step: float32 falls to the other side of a quarter octave once in ten thousand.
    assert np.abs(found - wanted).max() <= 1 and np.mean(found != wanted) < 1e-3


def test_lengths_that_disagree_are_refused():
    g = gaussians(4, 0)
    with pytest.raises(ValueError, match="differ in length"):
        cpu.encode(g, np.zeros((5, 32), np.uint8))
    with pytest.raises(ValueError, match="records of 32 bytes"):
        cpu.encode(g, np.zeros((5, 31), np.uint8))
    with pytest.raises(ValueError, match="degree 0"):
        cpu.decode(np.zeros((4, 32), np.uint8), g)
