"""The pixels of SOG: what the fast kernels must give, up to values that lie between two codes."""

from typing import NamedTuple

import numpy as np

from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Float32, Float64, Int32, UInt8


def encode(
    gaussians: Gaussians,
    places: Int32[Array, "n"],
    mean_ranges: Float64[Array, "2 3"],
    bounds: tuple[Float32[Array, "255"], Float32[Array, "255"]],
    pixels: dict[str, UInt8[Array, "m c"]],
    *,
    labels: Int32[Array, "n"] | None = None,
    threads: int = 0,
) -> None:
    """Set the pixel ``places`` of each row in each picture; a code counts the ``bounds``, of log-scales and of DC, below."""
    g = gaussians
    x = g.means.astype(np.float64)
    low, high = mean_ranges
    spread = np.where(high > low, high - low, 1.0)
    u = np.clip(np.rint((np.sign(x) * np.log1p(np.abs(x)) - low) / spread * 65535), 0, 65535).astype(np.uint16)
    pixels["means_l"][places], pixels["means_u"][places] = u & 255, u >> 8

    quats = g.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(quats).argmax(axis=1)
    quats *= np.where(np.take_along_axis(quats, largest[:, None], axis=1) < 0, -1.0, 1.0)  # q and −q are one rotation
    others = quats[np.arange(4) != largest[:, None]].reshape(-1, 3)
    pixels["quats"][places, :3] = np.clip(np.rint((others * np.sqrt(0.5) + 0.5) * 255), 0, 255)
    pixels["quats"][places, 3] = 252 + largest

    pixels["scales"][places] = np.searchsorted(bounds[0], g.log_scales)
    pixels["sh0"][places, :3] = np.searchsorted(bounds[1], g.sh[:, 0])
    pixels["sh0"][places, 3] = np.rint(255 * g.opacities())
    if labels is not None:
        pixels["labels"][places, 0], pixels["labels"][places, 1] = labels & 255, labels >> 8


class SogTables(NamedTuple):
    """What the codes of the pictures stand for."""

    means: Float32[Array, "3 65536"]
    """Coordinate of each code of 16 bits, axis by axis."""
    log_scales: Float32[Array, "3 256"]
    """Logarithm of the scale, axis by axis."""
    dc: Float32[Array, "3 256"]
    """DC of the harmonics, channel by channel."""
    logits: Float32[Array, "256"]
    """Opacity before the sigmoid."""
    rest: Float32[Array, "256"] | None = None
    """Harmonics beyond the DC; None: there are none."""
    palette: UInt8[Array, "p 3j"] | None = None
    """Codes of the harmonics that each label stands for."""


class SogDamage(NamedTuple):
    """The first rows with codes that stand for nothing; -1: there is none."""

    tag: int
    """Its alpha of quats is none of 252 to 255; its quaternion is zero."""
    label: int
    """Its label is beyond the palette; its harmonics beyond the DC are zero."""


def decode(pixels: dict[str, UInt8[Array, "n c"]], tables: SogTables, out: Gaussians, *, threads: int = 0) -> SogDamage:
    """Fill the columns of ``out`` from as many pixels of each picture (those of `encode`, and labels if there are any)."""
    low, high = pixels["means_l"], pixels["means_u"].astype(np.uint16)
    for channel in range(3):
        out.means[:, channel] = tables.means[channel][low[:, channel] | high[:, channel] << 8]
        out.log_scales[:, channel] = tables.log_scales[channel][pixels["scales"][:, channel]]
        out.sh[:, 0, channel] = tables.dc[channel][pixels["sh0"][:, channel]]
    out.logit_opacities[:] = tables.logits[pixels["sh0"][:, 3]]

    others = (pixels["quats"][:, :3] / 255 * 2 - 1) / np.sqrt(2)
    largest = pixels["quats"][:, 3].astype(np.int64) - 252
    wrong_tag = largest < 0
    top = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1)))
    for row in range(len(out)):
        out.quats[row] = 0 if wrong_tag[row] else np.insert(others[row], largest[row], top[row])

    wrong_label = np.zeros(len(out), bool)
    if tables.rest is not None and tables.palette is not None:
        labels = pixels["labels"][:, 0] | pixels["labels"][:, 1].astype(np.uint16) << 8
        wrong_label = labels >= len(tables.palette)
        rest = tables.rest[tables.palette[np.where(wrong_label, 0, labels)]]
        out.sh[:, 1:] = np.where(wrong_label[:, None], 0, rest).reshape(out.sh[:, 1:].shape)
    return SogDamage(*(int(np.argmax(wrong)) if wrong.any() else -1 for wrong in (wrong_tag, wrong_label)))
