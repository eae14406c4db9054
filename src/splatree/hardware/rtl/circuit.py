"""The circuit in Amaranth: four rows of three multipliers, adders, comparators, and a FIFO on each side.

A cluster enters the pipeline in each cycle. One signal, `advances`, moves the whole pipeline: if a kept cluster finds no room in
the FIFO at the output, every stage holds what it has. The stages are: products; sums of two products; sums with the third product
and the offset; second products of the rule `paper`; comparison.
"""

from amaranth import Cat, Module, Mux, Signal, signed, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from splatree.hardware.rtl.integers import COORDINATE_BITS, FRACTION_BITS, NUM_ROWS, OFFSET_BITS, WEIGHT_BITS

__all__ = ["ClusterLayout", "Identifier", "ViewLayout"]

FIFO_DEPTH = 16
"""Entries of the FIFO on each side."""
NUMBER_BITS = 16
"""Bits of a cluster's number."""
PRODUCT_BITS = COORDINATE_BITS + WEIGHT_BITS
SUM_BITS = OFFSET_BITS + 2

ClusterLayout = data.StructLayout(
    {
        "number": unsigned(NUMBER_BITS),
        "center": data.ArrayLayout(signed(COORDINATE_BITS), 3),
        "radius": unsigned(COORDINATE_BITS),
    }
)
"""A cluster at the input."""

ViewLayout = data.StructLayout(
    {
        "weights": data.ArrayLayout(data.ArrayLayout(signed(WEIGHT_BITS), 3), NUM_ROWS),
        "offsets": data.ArrayLayout(signed(OFFSET_BITS), NUM_ROWS),
        "slopes": data.ArrayLayout(signed(WEIGHT_BITS), 2),
        "is_paper": unsigned(1),
    }
)
"""A view; it must not change while clusters are in the pipeline."""


class Identifier(wiring.Component):  # type: ignore[misc]  # Amaranth has no types
    """Takes clusters and hands on the numbers of those that are kept, in order."""

    clusters: In(stream.Signature(ClusterLayout))  # type: ignore[valid-type]
    view: In(ViewLayout)  # type: ignore[valid-type]
    selected: Out(stream.Signature(unsigned(NUMBER_BITS)))  # type: ignore[valid-type]

    def elaborate(self, platform: object) -> Module:
        """Build the circuit."""
        m = Module()
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=ClusterLayout.size, depth=FIFO_DEPTH)
        m.submodules.chosen = chosen = SyncFIFOBuffered(width=NUMBER_BITS, depth=FIFO_DEPTH)
        cluster = data.View(ClusterLayout, waiting.r_data)
        advances = Signal()
        valid = [Signal(name=f"valid_{i}") for i in range(5)]
        number = [Signal(NUMBER_BITS, name=f"number_{i}") for i in range(5)]
        radius = [Signal(COORDINATE_BITS, name=f"radius_{i}") for i in range(4)]
        is_kept = Signal()
        m.d.comb += [
            waiting.w_data.eq(self.clusters.payload.as_value()),
            waiting.w_en.eq(self.clusters.valid),
            self.clusters.ready.eq(waiting.w_rdy),
            waiting.r_en.eq(advances),
            advances.eq(~(valid[4] & is_kept) | chosen.w_rdy),
            chosen.w_data.eq(number[4]),
            chosen.w_en.eq(valid[4] & is_kept),
            self.selected.payload.eq(chosen.r_data),
            self.selected.valid.eq(chosen.r_rdy),
            chosen.r_en.eq(self.selected.ready),
        ]

        products = [[Signal(signed(PRODUCT_BITS), name=f"product_{r}{k}") for k in range(3)] for r in range(NUM_ROWS)]
        pairs = [Signal(signed(PRODUCT_BITS + 1), name=f"pair_{r}") for r in range(NUM_ROWS)]
        thirds = [Signal(signed(PRODUCT_BITS), name=f"third_{r}") for r in range(NUM_ROWS)]
        sums = [Signal(signed(SUM_BITS), name=f"sum_{r}") for r in range(NUM_ROWS)]
        beyond = [Signal(name=f"beyond_{r}") for r in range(NUM_ROWS)]
        lefts = [Signal(signed(SUM_BITS + 1), name=f"left_{i}") for i in range(2)]
        rights = [Signal(signed(SUM_BITS + WEIGHT_BITS - FRACTION_BITS), name=f"right_{i}") for i in range(2)]
        in_front = Signal()
        reach = Cat(*[0] * FRACTION_BITS, radius[2])
        kept_by_paper = (lefts[0] <= rights[0]) & (lefts[1] <= rights[1]) & in_front

        with m.If(advances):
            m.d.sync += [valid[0].eq(waiting.r_rdy), number[0].eq(cluster.number), radius[0].eq(cluster.radius)]
            for i in range(1, 5):
                m.d.sync += [valid[i].eq(valid[i - 1]), number[i].eq(number[i - 1])]
            for i in range(1, 4):
                m.d.sync += radius[i].eq(radius[i - 1])
            for r in range(NUM_ROWS):
                for k in range(3):
                    m.d.sync += products[r][k].eq(cluster.center[k] * self.view.weights[r][k])
                m.d.sync += [
                    pairs[r].eq(products[r][0] + products[r][1]),
                    thirds[r].eq(products[r][2]),
                    sums[r].eq(pairs[r] + thirds[r] + self.view.offsets[r]),
                    beyond[r].eq(sums[r] > reach),
                ]
            for i in range(2):
                magnitude = Mux(sums[i] < 0, -sums[i], sums[i])
                m.d.sync += [
                    lefts[i].eq(magnitude - reach),
                    rights[i].eq(self.view.slopes[i] * (sums[2] >> FRACTION_BITS)),
                ]
            m.d.sync += [
                in_front.eq(sums[2] > 0),
                is_kept.eq(Mux(self.view.is_paper, kept_by_paper, ~Cat(*beyond).any())),
            ]
        return m
