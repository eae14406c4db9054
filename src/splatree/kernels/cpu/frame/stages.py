"""The stages of a frame on the processor, by the names of kernels/contract.py."""

from splatree.kernels.cpu.frame.bin import bin
from splatree.kernels.cpu.frame.blend import blend
from splatree.kernels.cpu.frame.project import project
from splatree.kernels.cpu.frame.select import select

__all__ = ["bin", "blend", "project", "select"]
