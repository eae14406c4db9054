"""Square millimetres and watts of a machine's blocks, at 28 nm, from the figures of GSCore (Lee 2024, Table 7) and of our RTL.

GSCore at 1 GHz: 4 units of culling and conversion 0.82 mm² and 0.52 W, 8 quick-sort units 0.01 and 0.01, 4 bitonic units 0.06 and
0.05, 64 rendering cores 1.81 and 0.25, 272 KB of buffers 1.25 and 0.04: together 3.95 mm² and 0.87 W. The identification engine
has 93 thousand gates by our RTL, 0.07 mm² at 28 nm. Power follows the clock; no other rule is applied.
"""

from dataclasses import dataclass

from splatree.hardware.config import Machine

__all__ = ["Area", "Block", "area_of"]


@dataclass(frozen=True)
class Block:
    """A block of the chip."""

    name: str
    """What it is."""
    mm2: float
    """Area at 28 nm."""
    watts: float
    """Power at the machine's clock while busy."""
    source: str
    """Where both come from."""


@dataclass(frozen=True)
class Area:
    """The blocks of a machine."""

    blocks: tuple[Block, ...]
    """Engines and memory."""

    @property
    def mm2(self) -> float:
        """Area of all blocks."""
        return sum(block.mm2 for block in self.blocks)

    @property
    def watts(self) -> float:
        """Power of all blocks, without DRAM."""
        return sum(block.watts for block in self.blocks)


LANE = (0.82 / 4, 0.52 / 4)
SORTER = (0.07, 0.06)
RENDERER = (1.81, 0.25)
SRAM = (1.25 / 272, 0.04 / 272)
IDENTIFICATION = (0.07, 0.02)
BOXES = (0.07, 0.02)
LEVEL_LANE = (0.025, 0.007)


def area_of(machine: Machine) -> Area:
    """Areas and power of the blocks of a machine.

    Args:
        machine: the accelerator.

    Returns:
        Its blocks. Step 2's colours are part of GSCore's units of conversion, so they have no block of their own.
    """
    clock = machine.clock_mhz / 1e3
    lanes, renderers = machine.step1.lanes, machine.back.renderers * machine.back.lanes / 64

    def block(name: str, count: float, unit: tuple[float, float], source: str) -> Block:
        return Block(name, count * unit[0], count * unit[1] * clock, source)

    blocks = [
        block(f"{lanes:g} lanes of steps 1 and 2", lanes, LANE, "GSCore, culling and conversion units"),
        block("sorter", machine.back.sort_keys / 16, SORTER, "GSCore, quick-sort and bitonic units"),
        block(f"{machine.back.renderers} renderers", renderers, RENDERER, "GSCore, 64 rendering cores each"),
        block(f"{machine.sram_kb:g} KiB of SRAM", machine.sram_kb, SRAM, "GSCore, buffers"),
    ]
    if machine.clustering:
        blocks.insert(0, block("identification", 1, IDENTIFICATION, "our RTL: 93 k gates; power assumed"))
        if machine.identification.rule == "boxes":
            blocks.insert(1, block("boxes in the identification", 1, BOXES, "assumed: as many multipliers once more"))
    if machine.selects_levels:
        name = f"{machine.levels.lanes:g} lanes of the selection of levels"
        blocks.insert(-1, block(name, machine.levels.lanes, LEVEL_LANE, "assumed: six of our RTL's multipliers each"))
    return Area(tuple(blocks))
