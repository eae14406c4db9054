"""Camera models of COLMAP by name, and what nerfstudio and instant-ngp write of lenses: a K and a `Lens`.

A model is its parameters in order: focal lengths, the principal point, and coefficients of distortion.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.scene.lens import Lens, LensModel
from splatree.shapes import Array, Float64

__all__ = ["NUMBERED", "intrinsics", "lens_of_record"]

MODELS: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "q1", "q2", "q3"),
    "FOV": ("fx", "fy", "cx", "cy", "k1"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "THIN_PRISM_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "s1", "s2"),
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": ("fx", "fy", "cx", "cy"),
}
"""Parameters of each model in COLMAP's order, by the letters of `Lens`."""

_REFUSED_MODELS: Mapping[str, int] = {
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""Numbers of parameters of COLMAP's models (4.2) that no lens here describes: a camera that no picture uses may be of these."""

_BY_NUMBER = """SIMPLE_PINHOLE PINHOLE SIMPLE_RADIAL RADIAL OPENCV OPENCV_FISHEYE FULL_OPENCV FOV SIMPLE_RADIAL_FISHEYE
    RADIAL_FISHEYE THIN_PRISM_FISHEYE RAD_TAN_THIN_PRISM_FISHEYE SIMPLE_DIVISION DIVISION SIMPLE_FISHEYE FISHEYE EUCM
    EQUIRECTANGULAR"""

NUMBERED: tuple[tuple[str, int], ...] = tuple(
    (name, len(MODELS[name]) if name in MODELS else _REFUSED_MODELS[name]) for name in _BY_NUMBER.split()
)
"""Name and number of parameters of each model, by its number in COLMAP's binary files."""

_UNDISTORT = "undistort the pictures first (colmap image_undistorter --output_type COLMAP)"
_CUT = "cut flat pictures out of the panoramas first (ns-process-data images --camera-type equirectangular)"

_REFUSED_KEYS = ("ftheta_p0", "latlong", "rolling_shutter", "equirectangular", "orthographic")
"""What instant-ngp writes of cameras that no lens here describes."""


def intrinsics(model: str, parameters: Sequence[float], where: str) -> tuple[Float64[Array, "3 3"], Lens | None]:
    """K and lens of a camera of COLMAP; no lens if it bends nothing.

    Raises:
        FormatError: the model is not known, or its parameters are not those of the model.
    """
    if model not in MODELS:
        raise _unknown(model, where)
    names = MODELS[model]
    if len(parameters) != len(names):
        raise FormatError(
            f"{where}: found {len(parameters)} parameters, wanted {len(names)} for {model}: {' '.join(names)}"
        )
    values = dict(zip(names, parameters, strict=True))
    if not np.isfinite(list(values.values())).all():
        raise FormatError(f"{where}: found NaN or infinity among {values}")
    fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
    K = np.array([[fx, 0, values["cx"]], [0, fy, values["cy"]], [0, 0, 1]], np.float64)
    kind: LensModel = "fov" if model == "FOV" else "fisheye" if "FISHEYE" in model else "brown"
    return K, _lens(kind, values)


def lens_of_record(record: Mapping[str, Any], where: str) -> Lens | None:
    """The lens that a frame or a file of nerfstudio or instant-ngp names.

    ``camera_model`` or ``is_fisheye`` names the formula; ``k1 … k6 p1 p2`` its coefficients (k5, k6 as in OpenCV's
    FULL_OPENCV), or ``distortion_params``: k1 k2 k3 k4 p1 p2.

    Raises:
        FormatError: it is of a kind that cannot be drawn.
    """
    for key in _REFUSED_KEYS:
        if record.get(key):
            raise FormatError(f"{where}: found {key}, which no camera here describes; {_UNDISTORT}")
    is_fisheye = record.get("is_fisheye")
    if is_fisheye not in (None, False, True):  # 0 and 1 are equal to these
        raise FormatError(f"{where}.is_fisheye: found {str(is_fisheye)[:40]!r}, wanted true or false")
    model = record.get("camera_model", "OPENCV_FISHEYE" if is_fisheye else "OPENCV")
    if model not in MODELS:
        raise _unknown(model, where)
    if "FISHEYE" not in model and is_fisheye:
        model = "OPENCV_FISHEYE"
    if record.get("distortion_params") is not None:
        listed = untrusted.as_list(record["distortion_params"], f"{where}.distortion_params")
        shape = (len(listed),)
        numbers = untrusted.numbers(record, "distortion_params", where, shape).tolist()
        if len(numbers) not in (4, 6):
            raise FormatError(f"{where}.distortion_params: found {len(numbers)} numbers, wanted k1 k2 k3 k4 p1 p2")
        values = dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), numbers, strict=False))
    else:
        keys = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "sx1", "sy1")
        values = {key: untrusted.number(record, key, where) for key in keys if key in record}
        if "FISHEYE" not in model and ("k5" in values or "k6" in values or model == "FULL_OPENCV"):
            values |= {q: values.pop(k) for q, k in (("q1", "k4"), ("q2", "k5"), ("q3", "k6")) if k in values}
        values |= {s: values.pop(k) for s, k in (("s1", "sx1"), ("s2", "sy1")) if k in values}
    kind: LensModel = "fov" if model == "FOV" else "fisheye" if "FISHEYE" in model else "brown"
    if kind == "fov" and "k1" not in values and "omega" in record:
        values["k1"] = untrusted.number(record, "omega", where)
    return _lens(kind, values)


def _unknown(model: Any, where: str) -> FormatError:
    advice = _CUT if model == "EQUIRECTANGULAR" else _UNDISTORT
    return FormatError(f"{where}: found camera model {str(model)[:40]!r}, wanted one of {', '.join(MODELS)}; {advice}")


def _lens(kind: LensModel, values: Mapping[str, float]) -> Lens | None:
    def row(letter: str) -> tuple[float, ...]:
        numbers = [float(values.get(f"{letter}{i}", 0.0)) for i in range(1, 7)]
        while numbers and numbers[-1] == 0:
            numbers.pop()
        return tuple(numbers)

    def pair(letter: str) -> tuple[float, float]:
        return float(values.get(f"{letter}1", 0.0)), float(values.get(f"{letter}2", 0.0))

    lens = Lens(kind, row("k"), row("q"), pair("p"), pair("s"))
    return None if lens.is_straight else lens
