"""The specification in NumPy float64: slow, short, obvious; no early exits but those of the definition. Loaded when used."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from splatree.kernels.contract import FrameStages
    from splatree.kernels.reference import bin, blend, blocks, cull, kmeans, project, select, spheres

_MODULES = ("bin", "blend", "blocks", "cull", "kmeans", "project", "select", "spheres")

__all__ = ["bin", "blend", "blocks", "cull", "frame_stages", "kmeans", "project", "select", "spheres"]


def frame_stages() -> "FrameStages":
    """The stages of a frame."""
    from splatree.kernels.reference import stages

    return stages


if not TYPE_CHECKING:

    def __getattr__(name: str) -> ModuleType:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return importlib.import_module(f"{__name__}.{name}")
