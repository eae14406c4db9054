"""The stages of a frame and of training on the processor, by the names of kernels/contract.py."""

from splatree.kernels.cpu.frame.backward import blend_backward, project_backward
from splatree.kernels.cpu.frame.bin import bin
from splatree.kernels.cpu.frame.blend import blend
from splatree.kernels.cpu.frame.project import project
from splatree.kernels.cpu.frame.select import select, select_range
from splatree.kernels.cpu.train.loss import photo_loss
from splatree.kernels.cpu.train.optimise import step

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
