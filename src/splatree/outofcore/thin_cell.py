"""Thin one cell as it is thinned within the whole scene, bit for bit.

Rows are taken in the order of the input, as in memory. What lies around the cell is loaded until every group whose
representative is in the cell is certainly complete: all that is within r of the representative has a certain one itself
(lod/grow_region.py has the argument). The cell owns these groups.
"""

from dataclasses import replace

import numpy as np

from splatree.io.writing import write
from splatree.kernels.cpu.build import merge as merge_kernel
from splatree.kernels.cpu.build import thin as thin_kernel
from splatree.lod.region import ROUNDING, Region
from splatree.outofcore.load import Loaded, harmonics, load, reaches
from splatree.outofcore.plan import Plan
from splatree.outofcore.work import Work, write_array
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.simplify.merge import importance_of, weights_of
from splatree.simplify.thin import linear_colors

__all__ = ["count_cell", "thin_cell"]


def count_cell(work: Work, plan: Plan, number: int, radius: float, threads: int = 0) -> dict[str, int]:
    """How many representatives lie in a cell."""
    _, _, is_owned = _decided(work, plan, number, radius, threads)
    return {"rows": int(is_owned.sum())}


def thin_cell(work: Work, plan: Plan, number: int, radius: float, threads: int = 0) -> dict[str, int]:
    """Write what is left of a cell, and the row of the input that each Gaussian stands for."""
    loaded, representatives, is_owned = _decided(work, plan, number, radius, threads)
    owned = np.flatnonzero(is_owned)
    members = np.flatnonzero(np.isin(representatives, owned))
    groups = thin_kernel.group(np.searchsorted(members, representatives[members]).astype(np.int32))
    gaussians = replace(loaded.gaussians.take(members), sh=harmonics(work, plan, loaded, members))
    merge = plan.resolved.merge
    weights = weights_of(gaussians, merge.weight or "opacity", log_unit=plan.resolved.log_unit)
    merged = merge_kernel.merge(gaussians, groups, weights, merge, threads=threads)
    write(Scene.flat(merged, mode=plan.mode), work.thinned(number), force=True)
    write_array(work.thinned_rows(number), loaded.inputs[owned])
    return {"rows": len(owned), "loaded": len(loaded.inputs)}


def _decided(work: Work, plan: Plan, number: int, radius: float, threads: int) -> tuple[Loaded, Array, Array]:
    """The rows around a cell in the order of the input, the representative of each, and whether it is one in the cell."""
    box, rules = plan.cells.boxes[number], plan.resolved
    for reach in reaches(box, radius):
        loaded = _in_order(load(work, plan, number, reach))
        gaussians = loaded.gaussians
        slack = Region(box, reach).slack
        distances = box.distances(gaussians.means)
        rim = reach - radius * (1 + ROUNDING) - slack
        representatives = thin_kernel.certain(
            *(gaussians.means, linear_colors(gaussians), importance_of(gaussians, rules.importance), distances > rim),
            radius=radius,
            color_radius=np.inf if rules.color_radius is None else rules.color_radius,
            threads=threads,
        )
        known = min(rim, float(distances[representatives < 0].min(initial=np.inf)))
        if known - radius * (1 + ROUNDING) - slack >= 0:
            is_representative = representatives == np.arange(len(representatives))
            return loaded, representatives, is_representative & box.holds(gaussians.means)
    raise AssertionError("reaches end")


def _in_order(loaded: Loaded) -> Loaded:
    order = np.argsort(loaded.inputs)
    return replace(
        loaded,
        gaussians=loaded.gaussians.take(order),
        inputs=loaded.inputs[order],
        cells=loaded.cells[order],
        rows=loaded.rows[order],
    )
