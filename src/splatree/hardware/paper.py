"""Jo 2024's own scenes as traces: the exclusion rates of Table I, on counts of Gaussians that are published for these scenes.

The paper does not tell how many Gaussians its models have. The counts are those of 3DGS's models as published with taming-3dgs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from splatree.hardware.config import Machine
from splatree.hardware.simulate import simulate_frame
from splatree.hardware.trace import FrameTrace, trace_of_rates

__all__ = ["COUNTS", "RATES", "Rates", "SpeedUp", "speed_up_of_clustering", "traces_of_table_i"]


@dataclass(frozen=True)
class Rates:
    """A row of Table I."""

    ideal: float
    """Share of the Gaussians that do not survive step 1."""
    exclusion: float
    """Share whose cluster is left out (distance + radius)."""


RATES: Mapping[str, Rates] = {
    "Bicycle": Rates(0.7550, 0.7376),
    "Bonsai": Rates(0.6732, 0.6352),
    "Counter": Rates(0.5644, 0.4942),
    "Garden": Rates(0.6746, 0.6431),
    "Kitchen": Rates(0.3905, 0.3171),
    "Room": Rates(0.7628, 0.6995),
    "Stump": Rates(0.8109, 0.7725),
    "Treehill": Rates(0.7758, 0.7450),
}
"""Mip-NeRF 360, Table I; bench/jo2024.py has all of the table, and a test holds the two to each other."""

COUNTS: Mapping[str, int] = {
    "Bicycle": 5_990_000,
    "Bonsai": 1_250_000,
    "Counter": 1_190_000,
    "Garden": 5_730_000,
    "Kitchen": 1_800_000,
    "Room": 1_550_000,
    "Stump": 4_870_000,
    "Treehill": 3_770_000,
}
"""Gaussians of 3DGS's models (humansensinglab/taming-3dgs)."""


@dataclass(frozen=True)
class SpeedUp:
    """What clustering saves of the front end, as the ratio of the sums of the scenes' times."""

    compulsory: float
    """By bytes that must be read: records, steps 1 and 2."""
    simulated: float
    """By the simulator: lines of 64 bytes that are read in part, projected records written, fills."""
    of_scene: Mapping[str, float]
    """The simulated one, scene by scene."""


def traces_of_table_i(
    *, share: float = 1.0, num_clusters: int = 8192, pairs_per_survivor: float = 6.0
) -> dict[str, FrameTrace]:
    """A trace for each scene of Mip-NeRF 360; ``share`` of its Gaussians and clusters, for quick runs."""
    rng = np.random.default_rng(0)
    return {
        name: trace_of_rates(
            int(share * count),
            exclusion=RATES[name].exclusion,
            ideal=RATES[name].ideal,
            num_clusters=max(1, int(share * num_clusters)),
            pairs_per_survivor=pairs_per_survivor,
            num_tiles_xy=(120, 68) if pairs_per_survivor else (1, 1),
            rng=rng,
        )
        for name, count in COUNTS.items()
    }


def speed_up_of_clustering(machine: Machine, *, share: float = 1.0, common_ms: float = 0.0) -> SpeedUp:
    """How much faster the front end is with clusters than without, with Table I's rates.

    Args:
        machine: the accelerator; its DRAM is taken at fidelity L0.
        share: of the Gaussians of each scene.
        common_ms: time of a frame that is the same with and without clusters, of a whole scene.
    """
    plain = replace(machine, dram=replace(machine.dram, fidelity="L0"))
    records = machine.records
    times, must = {}, np.zeros(2)
    for name, trace in traces_of_table_i(share=share, pairs_per_survivor=0.0).items():
        found = [
            simulate_frame(replace(plain, clustering=clustering), [trace]).front_milliseconds + share * common_ms
            for clustering in (False, True)
        ]
        times[name] = found
        survivors = int(trace.cluster_survivors.sum()) * records.color(trace.num_coefficients)
        kept = int(trace.cluster_rows[trace.cluster_kept].sum())
        read = len(trace.cluster_rows) * records.cluster(exact=False)
        must += [trace.num_rows * records.geometry + survivors, read + kept * records.geometry + survivors]
    without, having = np.sum(list(times.values()), axis=0)
    return SpeedUp(
        compulsory=float(must[0] / must[1]),
        simulated=float(without / having),
        of_scene={name: pair[0] / pair[1] for name, pair in times.items()},
    )
