"""The viewers' own decoders read the .ksplat and .rad that we write: GaussianSplats3D and Spark, under node.

``npm install --global @mkkellogg/gaussian-splats-3d @sparkjsdev/spark three`` and ``export NODE_PATH=$(npm root --global)``.
"""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import splatree
from splatree import Scene, WriteOptions
from splatree.constants import SH_C0
from splatree.io.formats.rad.nodes import nodes_of
from splatree.maths.rotations import matrices_from_quats

HERE = Path(__file__).parent
NODE, TOOL = shutil.which("node"), shutil.which("splat-transform")
BUNDLED = Path(splatree.__file__).parent / "data" / "semarang_5_9.sog"


def decoded(script: str, package: str, path: Path) -> bytes:
    if NODE is None:
        pytest.skip("node is not installed")
    if subprocess.run([NODE, "-e", f"require.resolve('{package}')"], capture_output=True).returncode:
        pytest.skip(f"node finds no {package}")
    out = path.with_suffix(".bin")
    subprocess.run([NODE, str(HERE / script), str(path), str(out)], check=True, capture_output=True)
    return out.read_bytes()


def block() -> Scene:
    """Every 97th Gaussian of the bundled city."""
    gaussians = splatree.read(BUNDLED).gaussians
    return Scene.flat(gaussians.take(np.arange(0, len(gaussians), 97)))


@pytest.mark.parametrize("level", [0, 1, 2])
def test_gaussian_splats_3d_decodes_our_ksplat_to_our_values(tmp_path, level):
    splatree.write(block(), tmp_path / "a.ksplat", options=WriteOptions(compression=level))
    data = decoded("decode_ksplat.mjs", "@mkkellogg/gaussian-splats-3d", tmp_path / "a.ksplat")
    n, degree = np.frombuffer(data, "<u4", 2)
    ours = splatree.read(tmp_path / "a.ksplat").gaussians
    assert (n, degree) == (len(ours), 2)
    theirs = np.frombuffer(data, "<f4", offset=8).reshape(n, -1)
    np.testing.assert_allclose(ours.means, theirs[:, :3], atol=1e-5)  # 40 m in float32, added up in another order
    np.testing.assert_allclose(np.exp(ours.log_scales), np.maximum(theirs[:, 3:6], 2.0**-25), rtol=1e-6)
    np.testing.assert_array_equal(ours.quats, theirs[:, [9, 6, 7, 8]])
    np.testing.assert_allclose((0.5 + SH_C0 * ours.sh[:, 0]) * 255, theirs[:, 10:13], atol=1e-4)
    np.testing.assert_allclose(255 / (1 + np.exp(-ours.logit_opacities)), theirs[:, 13], atol=1e-3)
    rest = theirs[:, 14:].reshape(n, 8, 3)
    if level == 2:  # handed over as codes
        low, high = np.frombuffer((tmp_path / "a.ksplat").read_bytes(), "<f4", 2, 36)
        rest = low + (high - low) * rest / 255
    np.testing.assert_allclose(ours.sh[:, 1:], rest, atol=1e-6)


@pytest.mark.skipif(TOOL is None, reason="splat-transform is not installed")
@pytest.mark.parametrize("level", [0, 1, 2])
def test_splat_transform_reads_our_ksplat(tmp_path, level):
    splatree.write(block(), tmp_path / "a.ksplat", options=WriteOptions(compression=level))
    subprocess.run(
        [str(TOOL), "-q", str(tmp_path / "a.ksplat"), str(tmp_path / "a.ply")], check=True, capture_output=True
    )
    ours, theirs = (splatree.read(tmp_path / name).gaussians for name in ("a.ksplat", "a.ply"))
    np.testing.assert_allclose(ours.means, theirs.means, atol=1e-5)
    np.testing.assert_allclose(ours.quats, theirs.quats, atol=1e-6)
    np.testing.assert_allclose(ours.sh, theirs.sh, atol=1e-6)
    positive = theirs.log_scales > -17  # 0 has no logarithm, and is read by a rule of each
    np.testing.assert_allclose(ours.log_scales[positive], theirs.log_scales[positive], atol=1e-6)
    np.testing.assert_allclose(*(1 / (1 + np.exp(-g.logit_opacities)) for g in (ours, theirs)), atol=1e-5)


@pytest.mark.parametrize(("compression", "method"), [(0, "radius"), (1, None), (2, "radius"), (2, "pairs")])
def test_spark_decodes_our_rad_to_our_values(tmp_path, compression, method):
    """Levels by pairs have extents that we keep in a property of our own: Spark passes over it."""
    levels = method is not None
    scene = splatree.build_lod(block(), splatree.BuildOptions(method)) if method else block()
    splatree.write(scene, tmp_path / "a.rad", options=WriteOptions(compression=compression))
    data = decoded("decode_rad.cjs", "@sparkjsdev/spark", tmp_path / "a.rad")
    count = np.frombuffer(data, "<u4", 1)[0]
    back = splatree.read(tmp_path / "a.rad")
    above = int(count) - len(scene)
    assert above == int(levels)
    words = np.frombuffer(data, "<u4", offset=8)
    first, second = words[: 4 * count].reshape(-1, 4), words[4 * count : 8 * count].reshape(-1, 4)
    nodes = nodes_of(scene, tmp_path) if levels else None
    ours = back.gaussians if nodes is None else back.gaussians.take(nodes.rows)
    first, second = first[above:], second[above:]

    # Spark keeps float32 means, half precision of everything else and rotations in 10, 10 and 12 bits.
    np.testing.assert_array_equal(ours.means, first[:, :3].copy().view("<f4"))
    halves = np.column_stack([first[:, 3:].copy().view("<u2")[:, :1], second[:, :3].copy().view("<u2")]).view("<f2")
    opacity, rgb, log_scales = halves[:, 0], halves[:, 1:4], halves[:, 4:].astype(np.float32)
    half = {"rtol": 2**-10, "atol": 2**-13}
    np.testing.assert_allclose(1 / (1 + np.exp(-ours.logit_opacities)), opacity, **half)
    np.testing.assert_allclose(0.5 + SH_C0 * ours.sh[:, 0], rgb, **half)
    np.testing.assert_allclose(ours.log_scales, log_scales, **half)
    turn = matrices_from_quats(ours.quats) @ np.swapaxes(matrices_from_quats(rotations(second[:, 3])), 1, 2)
    angles = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angles.max() < 0.5  # 1023 steps over the octahedron's two faces, 4095 over half a turn

    # A shared exponent, a byte and a sign each; the largest are clipped by up to a half.
    codes = words[8 * count : 12 * count].reshape(-1, 4)[above:, :3]
    step = 2.0 ** ((codes >> 27).astype(int) - 15) / 255
    sizes = np.stack([codes >> shift & 255 for shift in (0, 8, 16)], axis=-1)
    signs = np.stack([np.where(codes >> 24 & bit, -1, 1) for bit in (1, 2, 4)], axis=-1)
    harmonics = ours.sh[:, 1:4]
    whole = sizes < 255
    found = (sizes * signs * step[..., None])[whole]
    assert np.abs(harmonics[whole] - found).max() <= 0.51 * np.broadcast_to(step[..., None], sizes.shape)[whole].max()
    assert np.corrcoef(np.sign(harmonics).ravel(), signs.ravel())[0, 1] > 0.9  # 0 has a sign there

    if nodes is None:
        return
    tree = words[12 * count :].reshape(-1, 4)
    np.testing.assert_array_equal(tree[:, 2] & 0xFFFF, nodes.num_children)
    inner = nodes.num_children > 0
    np.testing.assert_array_equal(tree[inner, 3], nodes.first_child[inner])


def rotations(codes: np.ndarray) -> np.ndarray:
    """wxyz of Spark's 10-bit octahedral axis and 12-bit angle."""
    x, y = ((codes >> shift & 1023) / 1023 * 2 - 1 for shift in (0, 10))
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    axis = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    half_angle = (codes >> 20) / 4095 * np.pi / 2
    return np.column_stack([np.cos(half_angle), axis * np.sin(half_angle)[:, None]]).astype(np.float32)
