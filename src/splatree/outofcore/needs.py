"""How much memory a build of a scene needs, before anything of the scene but its heads is read."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from splatree.io.inputs import find_inputs
from splatree.io.joined_chunks import opened_chunks
from splatree.io.local import is_brought
from splatree.io.memory import PROCESS_BYTES, free_bytes
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, stored_bytes

__all__ = ["Needs", "needs_of"]

ROW_BYTES = 550
"""What a build in memory takes for each Gaussian without harmonics, by a radius or by pairs: benchmarks/scale.py."""

HARMONIC_BYTES = 30
"""What it takes besides for each coefficient of harmonics above degree 0."""


FEWEST_FILE_BYTES = 5
"""What a Gaussian takes in a file at least, whatever the format: it saves opening small files twice."""


@dataclass(frozen=True)
class Needs:
    """What a build in memory would take, and what there is."""

    num_bytes: int
    """Memory of the build, about."""
    free_bytes: int
    """Memory that is free."""

    @property
    def are_large(self) -> bool:
        """Whether the build would take more than half of what is free."""
        return 2 * self.num_bytes > self.free_bytes

    def __str__(self) -> str:
        return (
            f"the build takes about {self.num_bytes / 1e9:.1f} GB in memory, more than half of the "
            f"{self.free_bytes / 1e9:.1f} GB that are free"
        )


def needs_of(inputs: Sequence[Path], options: ReadOptions) -> Needs | None:
    """What a build of these inputs takes in memory; None: certainly little, or only reading them would tell.

    Heads of files say how many Gaussians they hold, where they are read in chunks. What has to be fetched or unpacked first is
    not asked.
    """
    if any(is_brought(path) or not path.exists() for path in inputs):
        return None
    found = find_inputs(inputs, lambda path: detect(path) is not None)
    free = free_bytes()
    most_rows = sum(map(stored_bytes, found.paths)) // FEWEST_FILE_BYTES
    if not Needs(PROCESS_BYTES + most_rows * (ROW_BYTES + 15 * HARMONIC_BYTES), free).are_large:
        return None
    heads = ReadOptions(
        axes=options.axes, ignore_properties=options.ignore_properties
    )  # to repair them is to read all rows
    parts = opened_chunks(found.paths, heads, leaves=True)
    if parts is None:
        return None
    num_rows = sum(map(len, parts))
    num_coefficients = (max(part.sh_degree for part in parts) + 1) ** 2
    row_bytes = ROW_BYTES + HARMONIC_BYTES * (num_coefficients - 1)
    return Needs(PROCESS_BYTES + num_rows * row_bytes, free)
