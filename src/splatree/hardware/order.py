"""In which order clusters are visited (Jo 2024, §4.3): the sooner kept clusters come, the sooner step 1 has work.

=================  ============================================================================================
`index`            as they lie in the file
`morton`           along a Morton curve through their centres
`frequency`        those first that were kept in most of the other views, the likely meaning of the paper
`previous-frame`   those first that were kept in the view before; one bit a cluster
`two-level`        √K super-clusters first, then the clusters of those that are kept: fewer records are read
`oracle`           kept ones first: nothing can be better
`adversarial`      kept ones last: nothing can be worse
=================  ============================================================================================
"""

from collections.abc import Sequence

import numpy as np

from splatree.hardware.config import Order
from splatree.hardware.trace import FrameTrace
from splatree.maths.morton import morton_codes
from splatree.shapes import Array, Int32

__all__ = ["visits_of"]


def visits_of(order: Order, traces: Sequence[FrameTrace], frame: int) -> Int32[Array, "s"]:
    """Clusters in the order of their visit; −1 for a record that is read and not kept."""
    trace = traces[frame]
    kept = trace.cluster_kept
    if order == "two-level":
        return _two_levels(trace)
    if order == "morton":
        rank = morton_codes(trace.cluster_centers).astype(np.float64)
    elif order == "frequency":
        others = [t.cluster_kept for i, t in enumerate(traces) if i != frame and t.is_of_scene_of(trace)]
        rank = -np.asarray(np.sum(others, axis=0, dtype=np.float64)) if others else np.zeros(len(kept))
    elif order == "previous-frame":
        known = frame > 0 and traces[frame - 1].is_of_scene_of(trace)
        rank = -traces[frame - 1].cluster_kept.astype(np.float64) if known else np.zeros(len(kept))
    elif order in ("oracle", "adversarial"):
        rank = np.where(kept, 0.0, 1.0) * (1 if order == "oracle" else -1)
    else:
        rank = np.zeros(len(kept))
    # Clusters above others are walked before these, whatever the order.
    clusters = np.lexsort([rank, ~trace.cluster_is_above]).astype(np.int32)
    return np.where(kept[clusters], clusters, np.int32(-1)).astype(np.int32)


def _two_levels(trace: FrameTrace) -> Int32[Array, "s"]:
    kept, number = trace.cluster_kept, len(trace.cluster_kept)
    if number == 0:
        return np.zeros(0, np.int32)
    along = np.argsort(morton_codes(trace.cluster_centers), kind="stable").astype(np.int32)
    parent = np.arange(number) // max(1, round(np.sqrt(number)))
    parent_kept = np.zeros(parent[-1] + 1, bool)
    np.logical_or.at(parent_kept, parent, kept[along])
    children = along[parent_kept[parent]]
    supers = np.full(len(parent_kept), -1, np.int32)
    return np.concatenate([supers, np.where(kept[children], children, np.int32(-1))]).astype(np.int32)
