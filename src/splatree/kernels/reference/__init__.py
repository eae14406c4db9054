"""The specification in NumPy float64: slow, short, obvious; no early exits but those of the definition."""

from splatree.kernels.reference import bin, blend, blocks, cull, kmeans, project, select, spheres

__all__ = ["bin", "blend", "blocks", "cull", "kmeans", "project", "select", "spheres"]
