"""What a frame needs: selection, culling, projection, binning, blending."""

from splatree.kernels.cpu.frame import bin, blend, blocks, cull, project, select

__all__ = ["bin", "blend", "blocks", "cull", "project", "select"]
