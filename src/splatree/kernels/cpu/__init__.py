"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``."""

from splatree.kernels.cpu import bin, blend, project

__all__ = ["bin", "blend", "project"]
