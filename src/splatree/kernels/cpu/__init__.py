"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``."""

from splatree.kernels.cpu import bin, blend, blocks, cull, kmeans, project, select, spheres

__all__ = ["bin", "blend", "blocks", "cull", "kmeans", "project", "select", "spheres"]
