"""The stages of a frame for a session that draws: the memory of the splats serves frame after frame.

Touching new memory costs a fifth of the processor time of a frame of 3 million rows. A session keeps 76 bytes for each splat of
its largest frame; what is never written costs nothing.
"""

from splatree.kernels.cpu.frame.bin import bin
from splatree.kernels.cpu.frame.blend import blend
from splatree.kernels.cpu.frame.project import SplatRoom, project_into
from splatree.kernels.cpu.frame.select import select, select_range
from splatree.scene.frame import Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, UInt32

__all__ = ["ReusingStages"]


class ReusingStages:
    """Stages whose splats are overwritten by the next projection."""

    def __init__(self) -> None:
        self._room = SplatRoom(0)
        self.select, self.select_range, self.bin, self.blend = select, select_range, bin, blend

    def project(
        self,
        gaussians: Gaussians,
        ids: UInt32[Array, "n"] | None,
        rows: Int32[Array, "v"],
        view: View,
        *,
        curves: Float32[Array, "n 4"] | None = None,
        threads: int = 0,
    ) -> Splats:
        """Splats of the rows that touch the image, until the next are projected."""
        if len(rows) > self._room.num_splats:
            self._room = SplatRoom(len(rows) + len(rows) // 8)
        return project_into(self._room, gaussians, ids, rows, view, curves=curves, threads=threads)
