"""Joules of a frame: counts of events times a table of energies, each with its source. Never one bare number.

28 nm at 0.9 V. Arithmetic and SRAM are the 45 nm figures of Horowitz (ISSCC 2014) times 0.507, the factor from 45 to 28 nm that
follows from the polynomials of Stillmaker and Baas (2017). DRAM follows from the currents of DRAMsim3's LPDDR4_8Gb_x16_2400; its
input and output pads are not in them.
"""

from dataclasses import dataclass, field

from splatree.hardware.config import Machine
from splatree.hardware.simulate import FrameTime

__all__ = ["Energy", "Technology", "energy_of"]


@dataclass(frozen=True)
class Arithmetic:
    """Picojoules of one operation."""

    add: float
    """Addition or comparison."""
    multiply: float
    """Multiplication."""
    divide: float
    """Division or square root (assumed: four multiplications)."""

    @property
    def exp(self) -> float:
        """Exponential (assumed: three multiplications)."""
        return 3 * self.multiply


@dataclass(frozen=True)
class Technology:
    """Energies of events."""

    fp32: Arithmetic = Arithmetic(add=0.46, multiply=1.9, divide=7.6)
    """Horowitz: 0.9 and 3.7 pJ at 45 nm."""
    fp16: Arithmetic = Arithmetic(add=0.20, multiply=0.56, divide=2.2)
    """Horowitz: 0.4 and 1.1 pJ at 45 nm."""
    fixed: Arithmetic = Arithmetic(add=0.05, multiply=0.8, divide=3.2)
    """Horowitz's 32-bit addition, 0.1 pJ; 24 × 18 bit multiplication assumed."""
    small_sram_pj_per_byte: float = 0.63
    """A bank of 8 KB (Horowitz: 10 pJ for 8 bytes at 45 nm)."""
    sram_pj_per_byte: float = 1.3
    """A bank of 32 KB (Horowitz: 20 pJ)."""
    read_pj_per_bit: float = 6.1
    """DRAM, a bit read (IDD4R)."""
    write_pj_per_bit: float = 5.6
    """DRAM, a bit written (IDD4W)."""
    activation_nj: float = 1.74
    """DRAM, a row opened and closed (IDD0)."""
    background_w: float = 0.069
    """DRAM, one device: 56 mW of background and 13 mW of refresh."""


@dataclass(frozen=True)
class Energy:
    """Millijoules of a frame, by where they go."""

    dram: float
    """Lines moved, rows opened, background."""
    sram: float
    """Buffers and caches on the chip."""
    step0: float
    """Arithmetic of the identification."""
    levels: float
    """Arithmetic of the selection of levels."""
    step1: float
    """Arithmetic of the projection."""
    step2: float
    """Arithmetic of the colours."""
    blend: float
    """Arithmetic of evaluating and blending."""
    exp: float
    """Exponentials of the evaluations."""
    static: float
    """What is drawn whatever happens."""
    technology: Technology = field(default_factory=Technology)
    """The table that they were taken from."""

    @property
    def total(self) -> float:
        """All of them."""
        return sum(self.stack.values())

    @property
    def stack(self) -> dict[str, float]:
        """By name, in the order of a stacked bar."""
        names = ("dram", "sram", "step0", "levels", "step1", "step2", "blend", "exp", "static")
        return {name: getattr(self, name) for name in names}


# Multiplications, additions and divisions of one item (spec of the accelerator: zero-skipping Jacobian in step 1).
STEP0_OPERATIONS = (12, 26, 0)
LEVEL_OPERATIONS = (6, 4, 0)  # e² (f + τ)² against τ² d², without a root
STEP1_OPERATIONS = (100, 70, 3)
STEP2_OPERATIONS = (70, 70, 0)
EVALUATION_OPERATIONS = (6, 6, 0)
BLEND_OPERATIONS = (4, 4, 0)
PIXEL_BYTES = 16
"""Colour and transmittance of a pixel, read and written when a splat is added to it."""


def energy_of(time: FrameTime, num_blended: int, technology: Technology | None = None) -> Energy:
    """What a frame takes.

    Args:
        time: the simulated frame.
        num_blended: evaluations that were added to a pixel.
        technology: energies of events; None: 28 nm.

    Returns:
        Millijoules by where they go.
    """
    table = technology or Technology()
    machine: Machine = time.machine
    unit: Arithmetic = getattr(table, machine.records.format)

    def arithmetic(count: float, operations: tuple[int, int, int]) -> float:
        multiplications, additions, divisions = operations
        return 1e-9 * count * (multiplications * unit.multiply + additions * unit.add + divisions * unit.divide)

    written = sum(time.bytes[name] for name in ("projected", "pairs", "frame"))
    read = time.total_bytes - written
    seconds = time.milliseconds / 1e3
    dram = 8e-9 * (read * table.read_pj_per_bit + written * table.write_pj_per_bit)
    dram += 1e-6 * time.activations * table.activation_nj + 1e3 * machine.dram.channels * table.background_w * seconds
    buffered = 2 * (time.total_bytes - time.bytes["records"]) + 64 * time.num_evaluations / machine.back.lanes
    small = 2 * time.bytes["records"] + 2 * PIXEL_BYTES * num_blended
    return Energy(
        dram=dram,
        sram=1e-9 * (buffered * table.sram_pj_per_byte + small * table.small_sram_pj_per_byte),
        step0=arithmetic(time.units["identification"].items, STEP0_OPERATIONS),
        levels=arithmetic(time.num_walked, LEVEL_OPERATIONS),
        step1=arithmetic(time.num_rows, STEP1_OPERATIONS),
        step2=arithmetic(time.num_survivors, STEP2_OPERATIONS),
        blend=arithmetic(time.num_evaluations, EVALUATION_OPERATIONS) + arithmetic(num_blended, BLEND_OPERATIONS),
        exp=1e-9 * time.num_evaluations * unit.exp,
        static=1e3 * machine.static_w * seconds,
        technology=table,
    )
