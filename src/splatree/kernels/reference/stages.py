"""The stages of a frame by definition, by the names of kernels/contract.py."""

from splatree.kernels.reference.backward import blend_backward, project_backward
from splatree.kernels.reference.bin import bin
from splatree.kernels.reference.blend import blend
from splatree.kernels.reference.loss import photo_loss
from splatree.kernels.reference.optimise import step
from splatree.kernels.reference.project import project
from splatree.kernels.reference.select import select, select_range

__all__ = [
    "bin",
    "blend",
    "blend_backward",
    "photo_loss",
    "project",
    "project_backward",
    "select",
    "select_range",
    "step",
]
