"""The machine: clocks, lanes, latencies, buffers, memory and number formats.

Jo 2024 (§4 and Table II) fixes the clock, the bandwidth, the memory on the chip and the three engines. Everything else is an
assumption: each field says where its default comes from. Sources: Jo = Jo 2024; GSCore = Lee 2024 (ASPLOS); Neo = the artefact of
arXiv 2511.12930; LPDDR4 = DRAMsim3's LPDDR4_8Gb_x16_2400; ours = chosen here.
"""

from dataclasses import dataclass, field
from typing import Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals

__all__ = ["BackEnd", "Dram", "Format", "Identification", "Levels", "Machine", "Records", "Step1", "Step2"]

Fidelity = Literal["L0", "L1", "L2"]
"""How the DRAM is modelled: bandwidth and latency; with refresh, turns and jumps; with channels and banks."""

Order = Literal["index", "morton", "frequency", "previous-frame", "two-level", "oracle", "adversarial"]
"""In which order clusters are visited (Jo 2024, §4.3); `oracle` and `adversarial` bound what any order can gain."""

Format = Literal["fp32", "fp16", "fixed"]
"""Number format of the records in DRAM."""


MOST_CYCLES = 10_000
"""Longest latency or wait: the core keeps what is on its way for that long."""
RATES = (1e-3, 1e6)
"""Items a cycle: a slower engine would take hours to simulate."""


@dataclass(frozen=True)
class Dram:
    """The memory beside the chip."""

    fidelity: Fidelity = "L1"
    """`L0` bandwidth and latency; `L1` also refresh, turns between reading and writing, and jumps; `L2` channels and banks."""
    bandwidth_gbps: float = 25.6
    """Peak of all channels, 10⁹ bytes a second (Jo, Table II; four channels of LPDDR4-3200 x16 have exactly that)."""
    latency_ns: float = 100.0
    """From a request to its first line while nothing else waits (ours: 50 cycles of 500 MHz)."""
    channels: int = 4
    """Channels (Neo)."""
    banks: int = 8
    """Banks of a channel (LPDDR4)."""
    line_bytes: int = 64
    """Bytes of one request (Neo)."""
    row_bytes: int = 2048
    """Bytes of an open row (LPDDR4)."""
    interleave_bytes: int = 256
    """Consecutive bytes in one channel (ours)."""
    window: int = 32
    """Requests of a channel among which those of open rows go first, L2 (ours)."""
    write_batch: int = 16
    """Lines that wait before the bus turns to writing (ours)."""
    activate_ns: float = 12.5
    """tRCD: opening a row (LPDDR4, 15 cycles of 0.833 ns)."""
    precharge_ns: float = 12.5
    """tRP: closing it (LPDDR4)."""
    row_active_ns: float = 26.7
    """tRAS: least time that a row stays open (LPDDR4, 32 cycles)."""
    activate_gap_ns: float = 10.0
    """tRRD: between two activations of a channel (JEDEC LPDDR4)."""
    four_activates_ns: float = 40.0
    """tFAW: window of four activations (JEDEC LPDDR4)."""
    turn_ns: float = 14.2
    """Turn between reading and writing, mean of both (LPDDR4: CWL + tWTR to reading, CL - CWL + 1 to writing, 17 cycles)."""
    refresh_ns: float = 326.5
    """tRFC: length of a refresh (LPDDR4, 392 cycles)."""
    refresh_interval_ns: float = 7213.8
    """tREFI: from one refresh to the next (LPDDR4, 8,660 cycles); 0: none."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "dram", (0.01, 1e6), "bandwidth_gbps")
        _between(self, "dram", (1, 64), "channels", "banks")
        _between(self, "dram", (1, 4096), "line_bytes", "window", "write_batch")
        _between(self, "dram", (1, 1 << 20), "row_bytes", "interleave_bytes")
        timed = ("latency_ns", "activate_ns", "precharge_ns", "row_active_ns", "activate_gap_ns", "four_activates_ns")
        _between(self, "dram", (0, 1e6), *timed, "turn_ns", "refresh_ns", "refresh_interval_ns")
        if 0 < self.refresh_interval_ns <= self.refresh_ns:
            raise InputError(
                f"dram.refresh_interval_ns: found {self.refresh_interval_ns:g}, wanted more than the {self.refresh_ns:g} of "
                "refresh_ns, or 0 for none"
            )
        if self.row_bytes % self.line_bytes or self.interleave_bytes % self.line_bytes:
            raise InputError(
                f"dram: found rows of {self.row_bytes} and turns of {self.interleave_bytes} bytes, wanted multiples of a "
                f"line, {self.line_bytes}"
            )


@dataclass(frozen=True)
class Identification:
    """Step 0: the cluster identification engine (CIE)."""

    rule: Literal["exact", "paper", "boxes"] = "exact"
    """`exact`: spheres and four side planes, which lose nothing; `paper`: Eq. 3 without its division, 8 bytes less a record;
    `boxes` (ours): boxes and side planes, which lose nothing either, in the same bytes with twice the multipliers."""
    interval: int = 1
    """Cycles from one cluster to the next: 1 is four rows of multipliers, 16 one shared column (ours)."""
    latency: int = 9
    """Cycles from the input to the output, two in each FIFO included (as the circuit that `splatree rtl` writes)."""
    record_fifo: int = 64
    """Records of clusters that wait (ours)."""
    selected_fifo: int = 16
    """Kept clusters that wait for step 1 (ours)."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "identification", (1, MOST_CYCLES), "interval", "latency", "record_fifo", "selected_fifo")
        if self.latency < 5 or self.selected_fifo < 2:
            raise InputError(
                f"identification: found a latency of {self.latency} cycles and {self.selected_fifo} selected clusters, wanted at "
                f"least 5 and 2: each FIFO takes two cycles and holds two entries"
            )


@dataclass(frozen=True)
class Levels:
    """Selection of levels of detail in front of step 1 (ours; the paper has none): kept clusters are walked in preorder."""

    lanes: float = 4.0
    """Rows a cycle (ours)."""
    latency: int = 12
    """Cycles of the pipeline (ours)."""
    buffer_kb: float = 16.0
    """One half of its ping-pong buffer, KiB (ours)."""

    def __post_init__(self) -> None:
        _between(self, "levels", RATES, "lanes", "buffer_kb")
        _between(self, "levels", (1, MOST_CYCLES), "latency")


@dataclass(frozen=True)
class Step1:
    """Projection of means and covariances, and which Gaussians touch the picture."""

    lanes: float = 4.0
    """Gaussians a cycle (GSCore has four units of culling and conversion)."""
    latency: int = 40
    """Cycles of the pipeline (ours)."""
    buffer_kb: float = 64.0
    """One half of the ping-pong buffer, KiB (ours)."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "step1", RATES, "lanes", "buffer_kb")
        _between(self, "step1", (1, MOST_CYCLES), "latency")


@dataclass(frozen=True)
class Step2:
    """Colours of the survivors."""

    lanes: float = 1.0
    """Gaussians a cycle: 48 multipliers (ours)."""
    latency: int = 30
    """Cycles of the pipeline (ours)."""
    buffer_kb: float = 128.0
    """One half of the ping-pong buffer, KiB (ours)."""
    streamed_share: float = 0.77
    """Share of survivors in a run from which all of its colours are read in one piece; above 1: never. A gathered record of 196
    bytes touches four lines, so 0.77 is where both take the same bytes."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "step2", RATES, "lanes", "buffer_kb")
        _between(self, "step2", (1, MOST_CYCLES), "latency")
        _between(self, "step2", (0, 1e6), "streamed_share")


@dataclass(frozen=True)
class BackEnd:
    """Distribution to tiles, sorting and blending."""

    pairs_per_cycle: float = 4.0
    """Pairs of splat and tile listed a cycle (ours)."""
    bin_kb: float = 128.0
    """Buffer of pairs that wait for their line, KiB (ours)."""
    sort_keys: int = 16
    """Keys that the bitonic unit takes a cycle (GSCore)."""
    sort_kb: float = 32.0
    """One half of the buffer of lists, KiB (ours)."""
    sort_latency: int = 20
    """Cycles of the sorter's pipeline (ours)."""
    renderers: int = 2
    """Tiles that are blended at once (ours; Neo has four)."""
    lanes: int = 64
    """Pixels of a renderer: one splat over one 8 × 8 px subtile a cycle (Neo)."""
    blend_latency: int = 12
    """Cycles of the blending pipeline (ours)."""
    skips_subtiles: bool = True
    """Whether a splat is evaluated only in the 8 × 8 px subtiles that its ellipse touches."""
    overlaps: bool = False
    """Whether the back end of one frame works beside the front end of the next."""
    cache_kb: float = 128.0
    """Cache of projected records, KiB (ours)."""
    cache_ways: int = 8
    """Ways of a set of the cache (ours)."""
    tile_order: Literal["rows", "morton"] = "morton"
    """Order in which tiles are drawn: row by row, or along a Morton curve, which finds more in the cache."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "back", RATES, "pairs_per_cycle", "bin_kb", "sort_kb")
        _between(self, "back", (1, 1 << 16), "sort_keys", "renderers", "lanes", "cache_ways")
        _between(self, "back", (0, MOST_CYCLES), "sort_latency", "blend_latency")
        _between(self, "back", (0, 1e6), "cache_kb")


@dataclass(frozen=True)
class Records:
    """Bytes of what lies in DRAM."""

    format: Format = "fp32"
    """`fp32` as in the paper; `fp16` as in Neo; `fixed` as in SPZ: 24-bit means, 8-bit scales and harmonics."""

    def __post_init__(self) -> None:
        check_literals(self)

    def cluster(self, *, exact: bool) -> int:
        """A cluster: centre, radius, first row, count; exact rules also read the means' radius, padded, or half sizes."""
        return 32 if exact else 24

    @property
    def level(self) -> int:
        """A row of the selection of levels: mean in fp32, extent rounded up, rows of the subtree; in each format."""
        return 16

    @property
    def geometry(self) -> int:
        """A Gaussian in step 1: mean, scale, quaternion."""
        return {"fp32": 40, "fp16": 20, "fixed": 16}[self.format]

    def color(self, coefficients: int) -> int:
        """A Gaussian in step 2: harmonics of three channels, opacity."""
        return (3 * coefficients + 1) * {"fp32": 4, "fp16": 2, "fixed": 1}[self.format]

    @property
    def splat(self) -> int:
        """A projected record."""
        return 44 if self.format == "fp32" else 22

    @property
    def pair(self) -> int:
        """An entry of a tile's list: depth and index."""
        return 8 if self.format == "fp32" else 6


@dataclass(frozen=True)
class Machine:
    """An accelerator: its clock, memories and engines.

    Example:
        >>> slow = st.Machine(name="slow", clock_mhz=250)
        >>> st.simulate(scene, [camera], slow).machine.name
        'slow'
    """

    name: str = "jo2024"
    """Name in tables."""
    clock_mhz: float = 500.0
    """Clock of the chip (Jo, Table II)."""
    clustering: bool = True
    """Whether clusters are identified; without, every Gaussian is read."""
    ping_pong: bool = True
    """Whether the engines have two halves of a buffer, or one."""
    selects_levels: bool = False
    """Whether levels of detail are selected on the chip; without, all leaves are drawn (ours)."""
    order: Order = "frequency"
    """Order in which clusters are visited (Jo, §4.3: "high usage frequencies")."""
    sram_kb: float = 1024.0
    """All memory on the chip, KiB (Jo, Table II)."""
    static_w: float = 0.3
    """Power that is drawn whatever happens, W (ours)."""
    dram: Dram = field(default_factory=Dram)
    """The memory beside the chip."""
    identification: Identification = field(default_factory=Identification)
    """Step 0."""
    levels: Levels = field(default_factory=Levels)
    """Selection of levels; used if ``selects_levels``."""
    step1: Step1 = field(default_factory=Step1)
    """Projection."""
    step2: Step2 = field(default_factory=Step2)
    """Colours."""
    back: BackEnd = field(default_factory=BackEnd)
    """Tiles."""
    records: Records = field(default_factory=Records)
    """Bytes of records."""

    def __post_init__(self) -> None:
        check_literals(self)
        _between(self, "machine", (1, 1e5), "clock_mhz")
        _between(self, "machine", (1, 1e6), "sram_kb")
        _between(self, "machine", (0, 1e4), "static_w")
        self._check_waits()
        if min(self.rows_of_step1, self.rows_of_step2(1), self.rows_of_levels) < 1:
            raise InputError(
                "machine: found a buffer that holds no record, wanted room for at least one; enlarge buffer_kb"
            )
        if 1024 * min(self.back.bin_kb, self.back.sort_kb) < self.records.pair:
            raise InputError(
                f"back: found {self.back.bin_kb:g} KiB of bins and {self.back.sort_kb:g} KiB of lists, wanted room for a pair of "
                f"{self.records.pair} bytes in each"
            )
        if 0 < 1024 * self.back.cache_kb < self.back.cache_ways * self.dram.line_bytes:
            raise InputError(
                f"back.cache_kb: found {self.back.cache_kb:g} KiB, wanted 0 or a set of {self.back.cache_ways} lines of "
                f"{self.dram.line_bytes} bytes"
            )
        halves = 2 if self.ping_pong else 1
        walk_kb = self.levels.buffer_kb if self.selects_levels else 0.0
        buffers = halves * (walk_kb + self.step1.buffer_kb + self.step2.buffer_kb + self.back.sort_kb)
        buffers += self.back.bin_kb + self.back.cache_kb
        if buffers > self.sram_kb:
            raise InputError(
                f"machine.sram_kb: found {self.sram_kb:g} KiB, wanted at least the {buffers:g} KiB of its buffers"
            )

    def _check_waits(self) -> None:
        for name in (
            "latency_ns",
            "turn_ns",
            "refresh_ns",
            "activate_ns",
            "precharge_ns",
            "row_active_ns",
            "four_activates_ns",
        ):
            found = self.cycles(getattr(self.dram, name))
            if found > MOST_CYCLES:
                raise InputError(f"dram.{name}: found {found:,.0f} cycles of the clock, wanted at most {MOST_CYCLES:,}")

    def cycles(self, nanoseconds: float) -> float:
        """Cycles of the chip's clock."""
        return nanoseconds * self.clock_mhz / 1e3

    @property
    def bytes_per_cycle(self) -> float:
        """DRAM's peak bytes in a cycle of the chip's clock."""
        return self.dram.bandwidth_gbps * 1e3 / self.clock_mhz

    @property
    def rows_of_levels(self) -> int:
        """Rows in one half of the buffer of the selection of levels."""
        return int(self.levels.buffer_kb * 1024 // self.records.level)

    @property
    def rows_of_step1(self) -> int:
        """Gaussians in one half of the buffer of step 1."""
        return int(self.step1.buffer_kb * 1024 // self.records.geometry)

    def rows_of_step2(self, coefficients: int) -> int:
        """Gaussians in one half of the buffer of step 2, with what step 1 left of them."""
        return int(self.step2.buffer_kb * 1024 // (self.records.color(coefficients) + self.records.splat))


def _between(options: object, group: str, limits: tuple[float, float], *names: str) -> None:
    low, high = limits
    for name in names:
        value = getattr(options, name)
        if not low <= value <= high:
            raise InputError(f"{group}.{name}: found {value!r}, wanted {low:g} to {high:g}")
