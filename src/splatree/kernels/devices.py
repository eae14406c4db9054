"""The back ends by name; the one place that knows their names.

A back end is the package ``splatree.kernels.<name>``; it is loaded when it is first asked for. To add one: the folder, its name
in `DeviceName`, and the kind of its tensors in `DLPACK_KINDS` if it has any.
"""

import importlib
from types import ModuleType
from typing import Any, Literal, cast, get_args

from splatree.errors import InputError
from splatree.kernels.contract import FrameStages, TrainingStages

__all__ = ["DLPACK_KINDS", "DeviceName", "back_end", "feature_of", "stages_of", "training_stages_of"]

DeviceName = Literal["cpu", "cuda", "reference"]
"""Where views are selected and drawn: on the processor; on an NVIDIA GPU; on the processor by the definitions in NumPy, which
are slow and there to compare with."""

DLPACK_KINDS: dict[int, DeviceName] = {1: "cpu", 2: "cuda"}
"""The device whose memory a tensor lies in, by DLPack's number of its kind."""


def back_end(device: str) -> ModuleType:
    """The package of a back end.

    Raises:
        InputError: there is none of that name.
    """
    if device not in get_args(DeviceName):
        raise InputError(f"device: found {device!r}, wanted one of {', '.join(get_args(DeviceName))}")
    return importlib.import_module(f"splatree.kernels.{device}")


def stages_of(device: str) -> FrameStages:
    """The stages of a frame of a back end.

    Raises:
        InputError: there is no back end of that name.
        DeviceError: the device is not there.
    """
    return cast(FrameStages, back_end(device).frame_stages())


def training_stages_of(device: str) -> TrainingStages:
    """The stages of a frame with those that training needs.

    Raises:
        InputError: there is no back end of that name, or it cannot train.
        DeviceError: the device is not there.
    """
    stages = stages_of(device)
    if not hasattr(stages, "project_backward"):
        raise InputError(f"device: found {device!r}, which cannot train; wanted a device that can")
    return cast(TrainingStages, stages)


def feature_of(device: str, name: str) -> Any | None:
    """An optional function of a back end (kernels/contract.py lists them); None if it is not supported."""
    return getattr(back_end(device), name, None)
