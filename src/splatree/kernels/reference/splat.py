"""Records of a .splat from columns, and back."""

import numpy as np

from splatree.constants import SH_C0
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array

__all__ = ["RECORD", "decode", "encode", "ranks"]

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])

OPACITY_MIN = 1e-6
"""Codes 0 and 255 stand for opacities without a logit; they are read as this far from 0 and 1."""


def encode(gaussians: Gaussians, records: Array) -> None:
    """Write each Gaussian into its 32 bytes of ``records``, uint8 "n 32"."""
    out = records.reshape(-1).view(RECORD)
    out["mean"] = gaussians.means
    out["scale"] = gaussians.scales()
    color = 0.5 + SH_C0 * gaussians.sh[:, 0].astype(np.float64)
    out["rgba"][:, :3] = np.rint(np.clip(color, 0, 1) * 255)
    out["rgba"][:, 3] = np.rint(255 * gaussians.opacities())
    quats = gaussians.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    # q and −q are one rotation: −1 has a code and +1 has none, so the largest component is made negative.
    largest = np.take_along_axis(quats, np.abs(quats).argmax(axis=1)[:, None], axis=1)
    quats *= -np.sign(largest)
    out["quat"] = np.clip(np.rint(128 * quats + 128), 0, 255)


def decode(records: Array, gaussians: Gaussians) -> None:
    """Fill the columns of ``gaussians``, of degree 0, from ``records``, uint8 "n 32"."""
    rows = records.reshape(-1).view(RECORD)
    gaussians.means[:] = rows["mean"]
    with np.errstate(divide="ignore", invalid="ignore"):
        gaussians.log_scales[:] = np.log(rows["scale"].astype(np.float64))
    gaussians.sh[:, 0] = (rows["rgba"][:, :3] / 255 - 0.5) / SH_C0
    share = np.clip(np.arange(256) / 255, OPACITY_MIN, 1 - OPACITY_MIN)
    gaussians.logit_opacities[:] = np.log(share / (1 - share))[rows["rgba"][:, 3]]
    gaussians.quats[:] = (rows["quat"].astype(np.float64) - 128) / 128


def ranks(gaussians: Gaussians, out: Array) -> None:
    """Fill ``out`` with the place of each row in the file: by descending opacity × volume in quarters of an octave."""
    octaves = (_log_opacities(gaussians) + gaussians.log_scales.sum(axis=1, dtype=np.float64)) / np.log(2)
    out[:] = np.clip(2048 - 4 * octaves, 0, 4095).astype(np.uint16)


def _log_opacities(gaussians: Gaussians) -> Array:
    logits = np.clip(gaussians.logit_opacities.astype(np.float64), -80, 80)  # as opacities of e⁻⁸⁰ all others rank
    return np.asarray(-np.logaddexp(0, -logits))
