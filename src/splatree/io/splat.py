"""``.splat`` (antimatter15): 32 bytes a Gaussian, no header, no harmonics beyond the DC.

======  ====  ==========================================================
offset  type  value
======  ====  ==========================================================
0       3 f4  mean
12      3 f4  standard deviations, linear
24      4 u1  RGB = ½ + C0 dc and opacity, 255 for 1
28      4 u1  unit quaternion wxyz, 128 + 128 q
======  ====  ==========================================================

Rows go by descending opacity × volume, so that a viewer that loads them one after the other shows the scene early. Nothing in
the file says what it is: it is known by its suffix and a size that is a multiple of 32. docs/formats/splat.md.
"""

import json
from pathlib import Path

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io.check import checked
from splatree.io.options import ReadOptions, WriteOptions
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source

_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_ROWS_AT_ONCE = 1 << 16
_OPACITY_MIN = 1e-6
"""Codes 0 and 255 stand for opacities without a logit; they are read as this far from 0 and 1."""


def sniff(path: Path, head: bytes) -> bool:
    """Never: the content has no mark, so only the suffix decides."""
    return False


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all rows in the order of the file."""
    num_bytes = path.stat().st_size
    num_rows, rest = divmod(num_bytes, _RECORD.itemsize)
    if rest and not options.repair:
        raise FormatError(
            f"{path}: found {num_bytes} bytes, wanted a multiple of {_RECORD.itemsize}; the file is cut off or no .splat: read "
            f"its {num_rows} whole rows with repair"
        )
    with task(f"read {path.name}", num_rows) as advance, path.open("rb") as file:
        records = np.fromfile(file, _RECORD, num_rows)
        advance(num_rows)
    with np.errstate(divide="ignore", invalid="ignore"):  # what has no logarithm is found by the check of values
        log_scales = np.log(records["scale"])
    color = records["rgba"][:, :3].astype(np.float32) / 255
    share = np.clip(np.arange(256) / 255, _OPACITY_MIN, 1 - _OPACITY_MIN)
    gaussians = Gaussians(
        np.ascontiguousarray(records["mean"]),
        (records["quat"].astype(np.float32) - 128) / 128,
        np.ascontiguousarray(log_scales),
        np.log(share / (1 - share)).astype(np.float32)[records["rgba"][:, 3]],
        ((color - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
    )
    metadata = {"repairs": json.dumps({"unexpected_bytes": rest})} if rest else {}
    return checked(Scene.flat(gaussians, source=Source(metadata=metadata)), str(path), repair=options.repair)


def write(scene: Scene, path: Path, options: WriteOptions) -> tuple[str, ...]:
    """Write all rows by descending opacity × volume; the harmonics beyond the DC and the mode are dropped."""
    g = checked(scene, "scene to write", repair=False).gaussians  # what cannot be used has no code either
    log_opacity = -np.logaddexp(0, -g.logit_opacities.astype(np.float64))
    order = np.argsort(-(log_opacity + g.log_scales.sum(axis=1, dtype=np.float64)), kind="stable")
    with path.open("wb") as file, task(f"write {path.name}", len(g)) as advance:
        for begin in range(0, len(g), _ROWS_AT_ONCE):
            rows = order[begin : begin + _ROWS_AT_ONCE]
            records = np.zeros(len(rows), _RECORD)
            records["mean"] = g.means[rows]
            records["scale"] = np.exp(g.log_scales[rows])
            color = 0.5 + SH_C0 * g.sh[rows, 0].astype(np.float64)
            records["rgba"][:, :3] = np.rint(np.clip(color, 0, 1) * 255)
            records["rgba"][:, 3] = np.rint(np.exp(log_opacity[rows]) * 255)
            quats = g.quats[rows].astype(np.float64)
            quats /= np.linalg.norm(quats, axis=1, keepdims=True)
            # q and −q are one rotation: −1 has a code and +1 has none, so the largest component is made negative.
            largest = np.take_along_axis(quats, np.abs(quats).argmax(axis=1)[:, None], axis=1)
            quats *= -np.sign(largest)
            records["quat"] = np.clip(np.rint(128 * quats + 128), 0, 255)
            file.write(records.tobytes())
            advance(len(rows))
    return ()
