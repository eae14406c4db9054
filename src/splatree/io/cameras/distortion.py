"""Which camera models are pinholes: COLMAP's models, of which nerfstudio uses some under the same names.

A model is its parameters in order; those that are not a focal length or the centre are distortion and must be zero.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from splatree.errors import FormatError
from splatree.shapes import Array, Float64

MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "FOV": ("fx", "fy", "cx", "cy", "omega"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "THIN_PRISM_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
}
"""Parameters of each model in COLMAP's order, which is also that of its numbers in binary files."""

_UNDISTORT = "undistort the pictures first (colmap image_undistorter --output_type COLMAP)"


def intrinsics(model: str, parameters: Sequence[float], where: str) -> Float64[Array, "3 3"]:
    """K of a camera that is a pinhole: of a model without a lens, or of one whose distortion is zero.

    Raises:
        FormatError: it is no pinhole.
    """
    if model not in MODELS:
        raise FormatError(f"{where}: found camera model {model!r}, wanted a pinhole; {_UNDISTORT}")
    names = MODELS[model]
    if len(parameters) != len(names):
        raise FormatError(
            f"{where}: found {len(parameters)} parameters, wanted {len(names)} for {model}: {' '.join(names)}"
        )
    values = dict(zip(names, parameters, strict=True))
    if not np.isfinite(list(values.values())).all():
        raise FormatError(f"{where}: found NaN or infinity among {values}")
    if "FISHEYE" in model or model == "FOV":
        raise FormatError(
            f"{where}: found camera model {model}, which is no pinhole even without distortion; {_UNDISTORT}"
        )
    bent = {name: value for name, value in values.items() if name[0] in "kp" and value != 0}
    if bent:
        raise FormatError(f"{where}: found distortion {bent} in model {model}, wanted none; {_UNDISTORT}")
    fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
    return np.array([[fx, 0, values["cx"]], [0, fy, values["cy"]], [0, 0, 1]], np.float64)
