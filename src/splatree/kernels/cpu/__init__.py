"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``. Loaded when used."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from splatree.kernels.cpu import bin, blend, blocks, cull, kmeans, project, select, spheres

__all__ = ["bin", "blend", "blocks", "cull", "kmeans", "project", "select", "spheres"]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> ModuleType:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return importlib.import_module(f"{__name__}.{name}")
