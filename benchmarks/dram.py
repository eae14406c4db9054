"""The DRAM of the accelerator (fidelity L2) beside DRAMsim3: sustained bandwidth of the same addresses in the same order.

    python benchmarks/dram.py --dramsim3 DRAMsim3/build/dramsim3main

One channel of LPDDR4-2400 x16 with the timings of DRAMsim3's LPDDR4_8Gb_x16_2400 in both. DRAMsim3 (MIT) is not part of splatree:
fetch and compile it, and name its program. Without it only ours is printed, and nothing is kept.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from harness import save, table
from splatree.hardware.config import Dram, Machine
from splatree.hardware.engines import work_of
from splatree.hardware.order import visits_of
from splatree.hardware.paper import traces_of_table_i
from splatree.hardware.replay import front_addresses, replay_ms

CLOCK_NS = 0.83
LINE = 32
"""A burst of 16 on 16 bits."""
DEVICE = Machine(
    name="lpddr4-2400",
    clock_mhz=1e3 / CLOCK_NS,
    dram=Dram(
        fidelity="L2",
        bandwidth_gbps=LINE / (8 * CLOCK_NS),
        latency_ns=25 * CLOCK_NS,
        channels=1,
        line_bytes=LINE,
        activate_ns=15 * CLOCK_NS,
        precharge_ns=15 * CLOCK_NS,
        row_active_ns=32 * CLOCK_NS,
        turn_ns=((14 + 16) + (17 - 14 + 1))
        / 2
        * CLOCK_NS,  # CWL + tWTR_L to reading, CL - CWL + 1 to writing; the mean
        activate_gap_ns=8 * CLOCK_NS,
        four_activates_ns=32 * CLOCK_NS,
        refresh_ns=392 * CLOCK_NS,
        refresh_interval_ns=8660 * CLOCK_NS,
    ),
)
KEPT_WRITES = 16
"""Writes that may stay in the buffer of DRAMsim3 at the end."""
INI = """[dram_structure]
protocol = LPDDR4
bankgroups = 2
banks_per_group = 4
rows = 65536
columns = 1024
device_width = 16
BL = 16
[timing]
tCK = 0.83
CL = 17
CWL = 14
tRCD = 15
tRP = 15
tRAS = 32
tRFC = 392
tREFI = 8660
tRRD_S = 8
tRRD_L = 8
tWTR_S = 8
tWTR_L = 16
tFAW = 32
tWR = 30
tRTP = 12
tCCD_S = 4
tCCD_L = 6
[system]
channel_size = 1024
channels = 1
bus_width = 16
address_mapping = rochrababgco
queue_structure = PER_BANK
row_buf_policy = OPEN_PAGE
cmd_queue_size = 8
trans_queue_size = 32
[other]
epoch_period = 1000000000
output_level = 1
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dramsim3", type=Path, help="dramsim3main")
    parser.add_argument("--lines", type=int, default=20_000, help="bursts of each pattern")
    args = parser.parse_args()
    peak = DEVICE.dram.bandwidth_gbps
    rows: list[dict[str, object]] = []
    for name, (addresses, writes) in patterns(args.lines).items():
        size = len(addresses) * LINE
        ours = size / replay_ms(DEVICE, addresses, writes) / 1e6
        row: dict[str, object] = {
            "pattern": name,
            "bursts": len(addresses),
            "writes %": 100 * writes.mean(),
            "ours % of peak": 100 * ours / peak,
        }
        if args.dramsim3:
            theirs = size / theirs_ms(args.dramsim3.resolve(), addresses, writes) / 1e6
            row |= {"DRAMsim3 % of peak": 100 * theirs / peak, "ours / theirs": ours / theirs}
        rows.append(row)
    print(table(rows))
    if args.dramsim3:
        about = (
            f"Sustained bandwidth of the accelerator's DRAM, L2, beside DRAMsim3: one channel, {peak:.2f} GB/s at most."
        )
        save("dram", rows, about=about)


def patterns(lines: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What the accelerator does to its DRAM: addresses in order, and which of them are written."""
    rng = np.random.default_rng(0)
    space = (1 << 29) // LINE
    blocks = rng.permutation(space // 512)[: lines // 512]
    gathers = rng.permutation(space // 2)[: lines // 2]
    trace = traces_of_table_i(share=0.02)["Bicycle"]
    work = work_of(DEVICE, trace, visits_of("index", [trace], 0))
    stream = LINE * np.arange(lines)
    gathered = LINE * (2 * gathers[:, None] + np.arange(2)).ravel()
    front = front_addresses(DEVICE, work, lines) % (1 << 30)
    reads = {
        "stream": stream,
        "16 KB blocks at random": LINE * (512 * blocks[:, None] + np.arange(512)).ravel(),
        "64 bytes at random": gathered,
        "32 bytes at random": LINE * rng.permutation(space)[:lines],
        "rows of one bank": DEVICE.dram.row_bytes * DEVICE.dram.banks * (np.arange(lines) % (1 << 16)),
        "front end of a frame": front,
    }
    half, space_bytes = lines // 2, space * LINE
    return {name: (addresses, np.zeros(len(addresses), bool)) for name, addresses in reads.items()} | {
        "stream, written": (stream, np.ones(lines, bool)),
        "a stream read, another written": mixed(stream[:half], space_bytes + stream[:half]),
        "front end, and a fifth as much written": mixed(front, space_bytes + stream[: len(front) // 5]),
        "64 bytes at random, and pairs written": mixed(gathered, space_bytes + stream[: len(gathered) // 3]),
    }


def mixed(reads: np.ndarray, writes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reads, and writes spread evenly among them."""
    place = np.concatenate([np.arange(len(reads)) / len(reads), (np.arange(len(writes)) + 0.5) / len(writes)])
    order = np.argsort(place, kind="stable")
    return np.concatenate([reads, writes])[order], order >= len(reads)


def theirs_ms(program: Path, addresses: np.ndarray, writes: np.ndarray) -> float:
    """Milliseconds of DRAMsim3 until the last line is served, but for the few writes that it keeps until more come."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "device.ini").write_text(INI)
        words = [
            f"0x{a:x} {'WRITE' if w else 'READ'} 0\n" for a, w in zip(addresses.tolist(), writes.tolist(), strict=True)
        ]
        (root / "trace.txt").write_text("".join(words))
        wanted = len(addresses) - (KEPT_WRITES if writes.any() else 0)

        def is_done(cycles: int) -> bool:
            options = ["-c", str(cycles), "-t", root / "trace.txt", "-o", root]
            subprocess.run([program, root / "device.ini", *options], check=True, capture_output=True)
            found = next(iter(json.loads((root / "dramsim3.json").read_text()).values()))
            return bool(found["num_reads_done"] + found["num_write_cmds"] >= wanted)

        # The program stops after a given number of cycles: the least number in which all is done is searched for.
        low, high = 0, 8 * len(addresses)
        while not is_done(high):
            low, high = high, int(high * 1.25)
        while high - low > max(64, high // 2000):
            middle = (low + high) // 2
            low, high = (low, middle) if is_done(middle) else (middle, high)
        return high * CLOCK_NS / 1e6


if __name__ == "__main__":
    main()
