import gzip
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

import splatree
from splatree import FormatError, Gaussians, InputError, Scene, WriteOptions
from splatree.constants import SH_C0
from splatree.io.chunks import Chunks
from splatree.io.formats.spz import format as spz
from splatree.maths.axes import AXES

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits

HALF_STEP = 0.5 + 1e-4  # of a code; the rest is rounding of float32


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def written(g, path, mode="classic", **options):
    splatree.write(Scene.flat(g, mode=mode), path, options=WriteOptions(**options), force=True)
    return splatree.read(path)


def angles(a: Gaussians, b: Gaussians):
    qa, qb = (g.quats.astype(np.float64) for g in (a, b))
    qa, qb = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (qa, qb))
    return np.degrees(2 * np.arccos(np.minimum(np.abs((qa * qb).sum(axis=1)), 1)))


def check_steps(a: Gaussians, b: Gaussians, *, version=4, sh_steps=(4, 8)):
    """Each field of b is within half a step of that of a, or clamped to the range of its code."""
    np.testing.assert_allclose(b.means, a.means, atol=HALF_STEP * 2**-12)
    np.testing.assert_allclose(b.log_scales, np.clip(a.log_scales, -10, 5.9375), atol=HALF_STEP / 16)
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(a.logit_opacities), atol=HALF_STEP / 255)
    dc = np.clip(a.sh[:, 0], -0.5 / 0.15, 0.5 / 0.15)
    np.testing.assert_allclose(b.sh[:, 0], dc, atol=HALF_STEP / (0.15 * 255))
    for rest, step in ((slice(1, 4), sh_steps[0]), (slice(4, 16), sh_steps[1])):
        # Rounded to a byte first, then to the step: half of each. 255 is the last code, whatever the step.
        tolerance = (HALF_STEP * step + (0.5 if step > 1 else 0)) / 128
        wanted = np.clip(a.sh[:, rest], -1, 1)
        np.testing.assert_allclose(b.sh[:, rest], wanted, atol=max(tolerance, HALF_STEP / 128 + 1 / 128 * (step == 1)))
    # Half of √½ / 511 in each of three; where all are ½, the largest is off by the sum of these: 0.0024 rad of a half angle.
    # Three bytes lose most where w is small.
    assert angles(a, b).max() < (0.28 if version > 2 else 12.1)


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("degree", range(4))
def test_every_field_is_within_half_a_step(tmp_path, version, degree):
    g = random_gaussians(700, degree)
    scene = written(g, tmp_path / "a.spz", format_version=version)
    assert scene.source.metadata["version"] == str(version) and scene.gaussians.sh_degree == degree
    check_steps(g, scene.gaussians, version=version)


def test_eight_bits_keep_harmonics_eight_times_finer(tmp_path):
    g = random_gaussians(700)
    check_steps(g, written(g, tmp_path / "a.spz", sh_bits=8).gaussians, sh_steps=(1, 1))


@pytest.mark.parametrize("version", [3, 4])
def test_codes_are_fixed_points(tmp_path, version):
    """What was read is written back bit for bit; so any number of round trips loses no more than the first."""
    once = written(random_gaussians(700), tmp_path / "a.spz", format_version=version).gaussians
    twice = written(once, tmp_path / "b.spz", format_version=version).gaussians
    assert all(same_bits(getattr(once, c), getattr(twice, c)) for c in COLUMNS if c != "quats")
    # Where two components are equal, rounding decides which is the largest, and the other is then off by up to a step.
    assert angles(once, twice).max() < 0.15


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("version", [2, 3, 4])
def test_the_mode_is_kept(tmp_path, mode, version):
    assert written(random_gaussians(3), tmp_path / "a.spz", mode, format_version=version).mode == mode


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("axes", AXES)
def test_axes_are_named_in_the_file_and_undone(tmp_path, version, axes):
    g = random_gaussians(50)
    scene = written(g, tmp_path / "a.spz", format_version=version, axes=axes, sh_bits=8)
    assert scene.source.metadata["axes"] == axes
    check_steps(g, scene.gaussians, version=version, sh_steps=(1, 1))


def test_axes_of_a_file_that_names_none_can_be_told(tmp_path):
    """Without the record, RDF is assumed; told RUB, the scene is turned by half a turn about x."""
    bare = without_axes(random_gaussians(50), tmp_path / "b.spz")
    a, b = splatree.read(bare), splatree.read(bare, axes="RUB")
    assert (a.source.metadata["axes"], b.source.metadata["axes"]) == ("RDF, assumed", "RUB, as told")
    assert "RDF, assumed; --input-axes says otherwise" in a.source.metadata["notes"]
    assert "notes" not in b.source.metadata
    np.testing.assert_array_equal(b.gaussians.means, a.gaussians.means * np.float32([1, -1, -1]))


def without_axes(g, path, *, version=4, axes=None):
    """A file as most programs write it: flags without "extensions", the table of planes where the record was."""
    written(g, path, format_version=version, axes=axes)
    data = path.read_bytes()
    if version == 4:
        bare = data[:14] + b"\0" + data[15:16] + struct.pack("<I", 32) + data[20:32] + data[44:]
    else:
        raw = bytearray(gzip.decompress(data)[:-12])
        raw[14] = 0
        bare = gzip.compress(raw)
    path.write_bytes(bare)
    return path


def thing(seed=0):
    """Gaussians over the origin with the lowest of them at y = 0, as in a .ply: y down, so that all y are negative."""
    g = random_gaussians(400, seed=seed)
    g.means[:] = np.random.default_rng(seed).uniform((-0.5, -3, -0.4), (0.5, 0, 0.4), (400, 3))
    return g


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("axes", ["RUB", "RDF"])
def test_a_thing_that_stands_on_0_is_read_upright_whichever_axes_its_writer_meant(tmp_path, version, axes):
    g = thing()
    scene = splatree.read(without_axes(g, tmp_path / "a.spz", version=version, axes=axes))
    np.testing.assert_allclose(scene.gaussians.means, g.means, atol=HALF_STEP * 2**-12)
    assert angles(g, scene.gaussians).max() < 12.1
    assert scene.source.metadata["axes"] == {"RUB": "RUB, as the scene stands on y = 0", "RDF": "RDF, assumed"}[axes]
    chunks = list(spz.read_chunks(tmp_path / "a.spz", splatree.ReadOptions()))
    np.testing.assert_array_equal(chunks[0].means, scene.gaussians.means)


@pytest.mark.parametrize("part", ["aside", "flat", "amid", "below"])
def test_a_cell_of_a_larger_scene_is_not_turned(tmp_path, part):
    """Cells that a writer cut at 0 reach it as the feet of a thing do, but lie aside or are flat."""
    g = thing()
    g.means[:, 1] *= -1  # y from 0 to 3
    match part:
        case "aside":
            g.means[:, 0] += 0.5
        case "flat":
            g.means[:, ::2] *= 20
        case "amid":
            g.means[:, 1] -= 1
        case "below":
            g.means[:, 1] += 0.2
    scene = splatree.read(without_axes(g, tmp_path / "a.spz", axes="RDF"))
    np.testing.assert_allclose(scene.gaussians.means, g.means, atol=HALF_STEP * 2**-12)


def test_a_few_floaters_hide_nothing_of_what_stands(tmp_path):
    g = random_gaussians(2000)
    g.means[:] = np.random.default_rng(1).uniform((-0.5, -3, -0.4), (0.5, 0, 0.4), (2000, 3))
    g.means[:3] = (40, 70, -30)
    scene = splatree.read(without_axes(g, tmp_path / "a.spz", axes="RUB"))
    np.testing.assert_allclose(scene.gaussians.means, g.means, atol=HALF_STEP * 2**-12)


def test_cells_that_would_be_turned_differently_are_not_joined(tmp_path):
    stands, aside = thing(), thing(1)
    aside.means[:] += (5, 0, 0)
    paths = [without_axes(g, tmp_path / f"{i}.spz", axes="RUB") for i, g in enumerate((stands, aside))]
    with pytest.raises(InputError, match=r"differ in their axes: found RDF, assumed and RUB, as .*--input-axes"):
        splatree.read(paths)
    joined = splatree.read(paths, axes="RUB").gaussians
    np.testing.assert_allclose(joined.means[:400], stands.means, atol=HALF_STEP * 2**-12)
    np.testing.assert_allclose(joined.means[400:], aside.means, atol=HALF_STEP * 2**-12)


def test_two_encodings_of_a_real_thing_agree(data):
    """biker_v4.spz has y up and does not say so; the .ply of the same thing has y down."""
    a, b = (splatree.read(data / "formats" / name).gaussians for name in ("biker_v4.spz", "biker.compressed.ply"))
    for share in (0.01, 0.1, 0.5, 0.9, 0.99):
        np.testing.assert_allclose(*(np.quantile(g.means, share, axis=0) for g in (a, b)), atol=2e-3)


@pytest.mark.parametrize(("far", "bits"), [(2047.0, 12), (2049.0, 11), (100_000.0, 6), (8_000_000.0, 0)])
def test_scenes_too_large_for_twelve_fractional_bits_get_fewer(tmp_path, far, bits):
    g = random_gaussians(50)
    g.means[20] = far
    lost = splatree.write(Scene.flat(g), tmp_path / "a.spz")
    back = splatree.read(tmp_path / "a.spz").gaussians
    np.testing.assert_allclose(back.means, g.means, atol=HALF_STEP * 2.0**-bits)
    assert any("precision of means" in sentence for sentence in lost) == (bits < 12)


def test_a_mean_out_of_range_is_refused_and_the_old_file_kept(tmp_path):
    g = random_gaussians(5)
    written(g, tmp_path / "a.spz")
    before = (tmp_path / "a.spz").read_bytes()
    g.means[3] = 1e9
    with pytest.raises(InputError, match="found a mean of magnitude 1e\\+09, wanted at most 8388607"):
        splatree.write(Scene.flat(g), tmp_path / "a.spz", force=True)
    assert (tmp_path / "a.spz").read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_what_is_clamped_is_told(tmp_path):
    g = random_gaussians(50)
    g.log_scales[:3, 1] = -11
    g.sh[7, 0] = 9
    g.sh[8, 5] = -2
    lost = " ".join(splatree.write(Scene.flat(g), tmp_path / "a.spz"))
    assert "scales outside of e^-10 to e^5.94: clamped in 3 Gaussians" in lost
    assert "colours outside" in lost and "harmonics outside of ±1: clamped in" in lost


def test_what_has_no_code_is_refused(tmp_path):
    g = random_gaussians(3)
    g.sh[1, 2, 0] = np.nan
    with pytest.raises(FormatError, match="scene to write: row 1, sh"):
        splatree.write(Scene.flat(g), tmp_path / "a.spz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("version", [2, 3, 4])
def test_no_gaussians_make_a_file(tmp_path, version):
    assert len(written(Gaussians.empty(2), tmp_path / "a.spz", format_version=version)) == 0


def test_chunks_of_any_size_give_the_same_bytes(tmp_path):
    g = random_gaussians(1000)

    def parts(rows):
        return lambda: (g.take(np.arange(i, min(i + rows, 1000))) for i in range(0, 1000, rows))

    for version in (3, 4):
        for rows in (1000, 77):
            chunks = Chunks(1000, 3, "classic", parts(rows))
            spz.write_chunks(chunks, tmp_path / f"{rows}.spz", WriteOptions(format_version=version))
        assert (tmp_path / "1000.spz").read_bytes() == (tmp_path / "77.spz").read_bytes()


def legacy_file(version, degree, planes, flags=0, bits=12, count=2, tail=b""):
    return gzip.compress(
        b"NGSP" + struct.pack("<IIBBBB", version, count, degree, bits, flags, 0) + b"".join(planes) + tail
    )


def test_version_1_has_positions_of_half_precision(tmp_path):
    positions = np.array([[1, -2, 0.5], [3, 4, -1024]], "<f2")
    planes = [positions.tobytes(), bytes([0, 255]), bytes([128] * 6), bytes([160] * 6), bytes([0, 128, 128] * 2)]
    (tmp_path / "a.spz").write_bytes(legacy_file(1, 0, planes))
    g = splatree.read(tmp_path / "a.spz").gaussians
    np.testing.assert_array_equal(g.means, positions.astype(np.float32))
    np.testing.assert_array_equal(g.log_scales, 0)
    assert (np.abs(g.logit_opacities) < 14).all()  # codes 0 and 255 have no logit


def test_known_bytes_are_known_values(tmp_path):
    """The worked example of each code."""
    planes = [
        bytes.fromhex("001000 00f0ff ffff7f") * 2,  # 1, −1, the largest
        bytes([51, 204]),
        bytes([0, 255, 128] * 2),
        bytes([0, 160, 255] * 2),
        struct.pack(
            "<II", 3 << 30, 0 << 30 | 1023 << 20 | 511 << 10
        ),  # the identity; x largest, y = −√½, z = +√½, w = 0
    ]
    (tmp_path / "a.spz").write_bytes(legacy_file(3, 0, planes))
    g = splatree.read(tmp_path / "a.spz").gaussians
    np.testing.assert_allclose(g.means[0], [1, -1, (2**23 - 1) / 4096])
    np.testing.assert_allclose(g.logit_opacities, [-np.log(4), np.log(4)], rtol=1e-6)
    np.testing.assert_allclose(g.sh[0, 0], [-1 / 0.3, 1 / 0.3, 0.5 / 255 / 0.15], rtol=1e-5)
    np.testing.assert_allclose(g.log_scales[0], [-10, 0, 5.9375])
    np.testing.assert_allclose(g.quats, [[1, 0, 0, 0], [0, 0, -np.sqrt(0.5), np.sqrt(0.5)]], atol=1e-3)


def test_degree_4_is_cut_off_and_told(tmp_path):
    degree_3 = np.arange(90, dtype=np.uint8).reshape(2, 45)
    harmonics = np.concatenate([degree_3, np.full((2, 27), 9, np.uint8)], axis=1)
    planes = [bytes(18), bytes(2), bytes(6), bytes(6), bytes(8), harmonics.tobytes()]
    (tmp_path / "a.spz").write_bytes(legacy_file(3, 4, planes))
    scene = splatree.read(tmp_path / "a.spz")
    np.testing.assert_allclose(scene.gaussians.sh[:, 1:].reshape(2, 45), (degree_3 - 128.0) / 128)
    assert "harmonics of degree 4" in json.loads(scene.source.metadata["lost"])[0]


@pytest.mark.parametrize("version", [3, 4])
def test_unknown_extension_records_are_passed_over(tmp_path, version):
    written(random_gaussians(4), tmp_path / "a.spz", format_version=version, axes="LUF")
    unknown = struct.pack("<II", 0x12340001, 5) + b"hello"
    data = (tmp_path / "a.spz").read_bytes()
    if version == 4:
        data = data[:16] + struct.pack("<I", 44 + len(unknown)) + data[20:32] + unknown + data[32:]
    else:
        raw = gzip.decompress(data)
        data = gzip.compress(raw[:-12] + unknown + raw[-12:])
    (tmp_path / "b.spz").write_bytes(data)
    a, b = (splatree.read(tmp_path / name) for name in ("a.spz", "b.spz"))
    assert b.source.metadata["axes"] == "LUF"
    assert all(same_bits(getattr(a.gaussians, c), getattr(b.gaussians, c)) for c in COLUMNS)


def bytes_of(tmp_path, version=4):
    written(random_gaussians(40), tmp_path / "good.spz", format_version=version)
    return (tmp_path / "good.spz").read_bytes()


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (4, struct.pack("<I", 5), "found version 5, wanted 4 without gzip"),
        (4, struct.pack("<I", 3), "found version 3, wanted 4 without gzip"),
        (8, struct.pack("<I", 41), "plane positions: found .* bytes for 360 .* wanted 369"),
        (12, b"\x05", "found harmonics of degree 5"),
        (12, b"\x00", "found 6 planes, wanted 5"),
        (13, b"\x1f", "found 31 fractional bits"),
        (16, struct.pack("<I", 7), "found the table of planes at byte 7"),
        (16, struct.pack("<I", 2**31), "found the table of planes at byte 2147483648"),
        (36, struct.pack("<I", 400), "extension record 0xadbe0003: found 400 bytes announced and 4 left"),
        (40, struct.pack("<I", 9), "found axes 9, wanted 1 to 8"),
        (44, struct.pack("<Q", 2**60), "plane positions: found 1152921504606846976 bytes"),
    ],
)
def test_a_wrong_header_is_named(tmp_path, at, value, message):
    data = bytes_of(tmp_path)
    (tmp_path / "bad.spz").write_bytes(data[:at] + value + data[at + len(value) :])
    with pytest.raises(FormatError, match=message):
        splatree.read(tmp_path / "bad.spz")


def test_a_lying_count_is_refused_before_anything_is_inflated(tmp_path):
    (tmp_path / "a.spz").write_bytes(legacy_file(3, 3, [bytes(1000)], count=2**32 - 1))
    with pytest.raises(FormatError, match=r"found 4294967295 Gaussians in .* bytes, wanted at most 16 a byte"):
        splatree.read(tmp_path / "a.spz")


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.9, 0.999])
def test_a_file_cut_off_anywhere_is_refused(tmp_path, version, share):
    data = bytes_of(tmp_path, version)
    (tmp_path / "bad.spz").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError):
        splatree.read(tmp_path / "bad.spz")


def test_a_plane_that_inflates_to_more_than_its_rows_is_refused(tmp_path):
    data = bytes_of(tmp_path)
    table = list(struct.unpack("<12Q", data[44:140]))
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 26))
    end = 140 + table[0]
    table[0] = len(bomb)
    (tmp_path / "bad.spz").write_bytes(data[:44] + struct.pack("<12Q", *table) + bomb + data[end:])
    with pytest.raises(FormatError, match="plane positions: found more bytes than its rows take"):
        splatree.read(tmp_path / "bad.spz")


@pytest.mark.parametrize("count", [10, 1 << 26])
def test_a_gzip_that_inflates_to_more_than_its_planes_is_refused(tmp_path, count):
    planes = [bytes(18), bytes(2), bytes(6), bytes(6), bytes(8)]
    (tmp_path / "a.spz").write_bytes(legacy_file(3, 0, planes, tail=bytes(count)))
    if count == 10:
        assert len(splatree.read(tmp_path / "a.spz", repair=True)) == 2  # a few bytes behind the planes mean nothing
    else:
        with pytest.raises(FormatError, match="more than 1048576 bytes behind its planes"):
            splatree.read(tmp_path / "a.spz")


@pytest.mark.parametrize(
    ("option", "value"), [("format_version", 1), ("format_version", 5), ("sh_bits", 9), ("compression", 99)]
)
def test_options_out_of_range_are_refused(tmp_path, option, value):
    with pytest.raises(InputError, match=str(value)):
        written(random_gaussians(3), tmp_path / "a.spz", **{option: value})


@given(st.sampled_from([2, 3, 4]), st.integers(0, 3), st.integers(1, 8), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_any_options_round_trip(tmp_path_factory, version, degree, bits, seed):
    g = random_gaussians(33, degree, seed)
    path = tmp_path_factory.mktemp("spz") / "a.spz"
    back = written(g, path, format_version=version, sh_bits=bits, compression=1 + seed % 9).gaussians
    check_steps(g, back, version=version, sh_steps=(1 << 8 - min(8, bits + 1), 1 << 8 - bits))


@pytest.mark.parametrize("name", ["block_v3.spz", "block_v4.spz"])
def test_real_files_hold_the_block(data, name):
    folder = data / "formats" / "semarang_block"
    check_steps(
        splatree.read(folder / "block_inria.ply").gaussians, splatree.read(folder / name).gaussians, sh_steps=(8, 16)
    )


def test_real_block_is_written_with_the_codes_of_the_formats_own_writer(data, tmp_path):
    """block_v3.spz was made by the format's own library: all 65 codes of 29,213 Gaussians are the same."""
    folder = data / "formats" / "semarang_block"
    splatree.write(
        splatree.read(folder / "block_inria.ply"), tmp_path / "a.spz", options=WriteOptions(format_version=3, sh_bits=4)
    )
    ours, theirs = (
        np.frombuffer(gzip.decompress(path.read_bytes())[16:], np.uint8)
        for path in (tmp_path / "a.spz", folder / "block_v3.spz")
    )
    np.testing.assert_array_equal(ours[: len(theirs)], theirs)


def test_colors_of_codes_are_those_of_the_eye(tmp_path):
    """The range of the colour code is wider than that of the eye: black and white are inside."""
    g = random_gaussians(2, 0)
    g.sh[:] = np.array([[[-0.5], [0.5]]]).reshape(2, 1, 1) / SH_C0
    np.testing.assert_allclose(written(g, tmp_path / "a.spz").gaussians.sh * SH_C0, g.sh * SH_C0, atol=0.004)


@pytest.mark.parametrize(("scale", "bits"), [(1.0, 12), (0.03, 12), (0.003, 15), (1e-6, 16)])
def test_small_things_keep_their_places(tmp_path, scale, bits):
    """Steps of an eighth of a standard deviation move what 12 bits would move by more than its size; 16 serve e^-10."""
    g = random_gaussians(50)
    log_scales = np.full((50, 3), np.log(0.06 * scale), np.float32)
    small = replace(g, means=g.means * np.float32(scale), log_scales=log_scales)
    found = written(small, tmp_path / "a.spz").gaussians
    data = (tmp_path / "a.spz").read_bytes()
    assert data[13] == bits
    step = 2.0**-bits
    assert np.abs(found.means - small.means).max() <= step / 2 * (1 + 1e-6)
    assert bits == 16 or step <= 0.25 * 0.06 * scale


def test_a_small_thing_with_a_far_outlier_gets_fewer_bits(tmp_path):
    g = random_gaussians(50)
    means = g.means * np.float32(0.001)
    means[7] = 5000
    written(replace(g, means=means, log_scales=np.full((50, 3), -9, np.float32)), tmp_path / "a.spz")
    assert (tmp_path / "a.spz").read_bytes()[13] == 10
