"""The device code of this package: its files, and which kernel lies in which.

Kernels and their threads are read from the lines that begin with SPLATREE_KERNEL, since the sources are compiled at run time, one
file at a time, and only when a kernel of the file is asked for.
"""

import re
from functools import cache
from pathlib import Path

__all__ = ["STAGES", "headers", "kernels_of", "source", "stage_of", "threads_of"]

ROOT = Path(__file__).parent.parent
STAGES = (
    *("select", "project", "order", "bin", "blend", "baselines", "kmeans"),
    *("blend_backward", "project_backward", "loss", "optimise"),
)
"""Files of kernels; each is compiled on its own."""


@cache
def headers() -> dict[str, str]:
    """Text of each header by the name under which it is included."""
    paths = [*(ROOT / "shared").glob("*.h"), *(ROOT / "cuda").glob("*.h")]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted(paths)}


@cache
def source(stage: str) -> str:
    """Text of a file of kernels."""
    return (ROOT / "cuda" / f"{stage}.cu").read_text(encoding="utf-8")


@cache
def kernels_of(stage: str) -> dict[str, int]:
    """Kernels of a file, with the threads of a thread block."""
    return {
        name: int(threads)
        for threads, name in re.findall(r"^SPLATREE_KERNEL\((\d+), \d\) (\w+)\(", source(stage), re.M)
    }


def stage_of(kernel: str) -> str:
    """The file that a kernel lies in."""
    return next(stage for stage in STAGES if kernel in kernels_of(stage))


def threads_of(kernel: str) -> int:
    """Threads of a thread block of a kernel."""
    return kernels_of(stage_of(kernel))[kernel]
