"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``."""

from splatree.kernels.cpu import bin, blend, blocks, kmeans, project, select

__all__ = ["bin", "blend", "blocks", "kmeans", "project", "select"]
