"""Jo 2024's own scenes as traces: the exclusion rates of Table I, on counts of Gaussians that are published for these scenes.

The paper does not tell how many Gaussians its models have. The counts are those of 3DGS's models as published with taming-3dgs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from splatree.hardware.config import Machine
from splatree.hardware.simulate import simulate_frame
from splatree.hardware.trace import FrameTrace, trace_of_rates

__all__ = [
    "COUNTS",
    "RATES",
    "Rates",
    "SpeedUp",
    "compulsory_ms",
    "compulsory_speed_up",
    "fitted_common_ms",
    "speed_up_of_clustering",
    "traces_of_table_i",
]


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

COEFFICIENTS = 16
"""Harmonics of a channel in these models: degree 3."""


@dataclass(frozen=True)
class SpeedUp:
    """What clustering saves of the front end, as the ratio of the sums of the scenes' times."""

    compulsory: float
    """By bytes that must be read: records, steps 1 and 2."""
    simulated: float
    """By the simulator: lines of 64 bytes that are read in part, projected records written, fills."""
    of_scene: Mapping[str, float]
    """The simulated one, scene by scene."""
    milliseconds: Mapping[str, tuple[float, float]]
    """Simulated front end without and with clusters, scene by scene."""


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


def compulsory_ms(machine: Machine, scene: str, *, clustering: bool, num_clusters: int = 8192) -> float:
    """Least time of a scene's frame: bytes that must be read over the bandwidth, or Gaussians over the lanes if that is longer.

    Args:
        machine: the accelerator.
        scene: a name of Table I.
        clustering: whether clusters are identified.
        num_clusters: records that are read then.
    """
    records, count, rates = machine.records, COUNTS[scene], RATES[scene]
    read = count * (1 - rates.exclusion if clustering else 1.0)
    survivors = count * (1 - rates.ideal)
    size = read * records.geometry + survivors * records.color(COEFFICIENTS)
    size += num_clusters * records.cluster(exact=False) if clustering else 0
    cycles = max(read / machine.step1.lanes, survivors / machine.step2.lanes)
    return max(size / machine.dram.bandwidth_gbps / 1e6, cycles / machine.clock_mhz / 1e3)


def compulsory_speed_up(machine: Machine, common_ms: float = 0.0) -> float:
    """The speed-up of clustering by these least times, each scene with ``common_ms`` that clusters do not change."""
    without, having = (
        sum(compulsory_ms(machine, scene, clustering=clustering) + common_ms for scene in COUNTS)
        for clustering in (False, True)
    )
    return without / having


def fitted_common_ms(machine: Machine, speed_up: float) -> float:
    """The common time with which the least times give a speed-up: (Σ without + n c) / (Σ with + n c) = s, solved for c."""
    without, having = (
        sum(compulsory_ms(machine, scene, clustering=clustering) for scene in COUNTS) for clustering in (False, True)
    )
    return (without - speed_up * having) / (len(COUNTS) * (speed_up - 1))


def speed_up_of_clustering(machine: Machine, *, share: float = 1.0, common_ms: float = 0.0) -> SpeedUp:
    """How much faster the front end is with clusters than without, with Table I's rates.

    Args:
        machine: the accelerator; its DRAM is taken at fidelity L0.
        share: of the Gaussians of each scene.
        common_ms: time of a frame that is the same with and without clusters, of a whole scene.
    """
    plain = replace(machine, dram=replace(machine.dram, fidelity="L0"))
    times = {}
    for name, trace in traces_of_table_i(share=share, pairs_per_survivor=0.0).items():
        without, having = (
            simulate_frame(replace(plain, clustering=clustering), [trace]).front_milliseconds + share * common_ms
            for clustering in (False, True)
        )
        times[name] = (without, having)
    return SpeedUp(
        compulsory=compulsory_speed_up(machine, common_ms),
        simulated=sum(pair[0] for pair in times.values()) / sum(pair[1] for pair in times.values()),
        of_scene={name: pair[0] / pair[1] for name, pair in times.items()},
        milliseconds=times,
    )
