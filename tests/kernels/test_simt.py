"""The emulator finds what it is there to find."""

import numpy as np
import pytest

from splatree.errors import DeviceError
from splatree.kernels.cuda.driver import DeviceArray
from splatree.kernels.cuda.job import pack_job
from splatree.scene.view import View

from .simt_device import Emulator

THREADS = 64


def job_of(emulator: Emulator, arrays: dict[str, DeviceArray]) -> DeviceArray:
    from splatree.kernels.cuda.job import pack_numbers
    from splatree.scene.options import SelectOptions

    from ..scenes import camera

    numbers = pack_numbers(View(camera()), SelectOptions(), degree=0)
    return emulator.upload(pack_job(numbers, {name: a.pointer for name, a in arrays.items()}, {"num_rows": THREADS}))


FAULTS = {
    "index_behind_the_end": "alpha: found index 1?[0-9]+ of 64",
    "read_of_nothing": "depth, word [0-9]+: read before it is written",
    "read_of_another_threads_word": "cells, word [0-9]+: (read before it is written|race)",
    "warp_barrier_for_a_block": "cells, word [0-9]+: (read before it is written|race)",
    "two_writers": "alpha, word [0-9]+: race of two writes",
    "blocks_that_share_a_word": "alpha, word 0: race of two writes",
    "barrier_of_a_few": "waits at __syncthreads; .*54 threads have ended",
    "vote_of_a_few": "waits at __ballot_sync",
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("num_resident", [1, 3])
def test_a_fault_is_found_whatever_the_schedule(fault: str, seed: int, num_resident: int, emulator: Emulator) -> None:
    emulator.seed(seed)
    emulator.interleave(num_resident)
    emulator.add_kernel(fault, THREADS)
    arrays = {name: emulator.empty((THREADS,), np.float32, name=name) for name in ("alpha", "depth")}
    emulator.launch(fault, 2, job_of(emulator, arrays))
    with pytest.raises(DeviceError, match=FAULTS[fault]):
        emulator.wait()


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("num_resident", [1, 3])
def test_code_without_a_fault_runs(seed: int, num_resident: int, emulator: Emulator) -> None:
    emulator.seed(seed)
    emulator.interleave(num_resident)
    emulator.add_kernel("no_fault", THREADS)
    arrays = {"alpha": emulator.empty((THREADS,), np.float32), "counters": emulator.upload(np.zeros(8, np.uint64))}
    emulator.launch("no_fault", 3, job_of(emulator, arrays))
    np.testing.assert_array_equal(arrays["alpha"].numpy(), np.arange(THREADS) ^ 32)
    assert arrays["counters"].numpy()[0] == 3 * THREADS


def chained(emulator: Emulator, kernel: str, num_blocks: int, argument: int = 0) -> tuple[list[int], list[int]]:
    """What a kernel of 64 threads leaves in the chains and the tickets."""
    emulator.add_kernel(kernel, THREADS)
    arrays = {
        "chains": emulator.upload(np.zeros(num_blocks, np.uint64)),
        "tickets": emulator.upload(np.zeros(3, np.uint32)),
    }
    emulator.launch(kernel, num_blocks, job_of(emulator, arrays), argument)
    return arrays["chains"].numpy().tolist(), arrays["tickets"].numpy().tolist()


@pytest.mark.parametrize("num_resident", [1, 2, 4])
def test_as_many_blocks_take_turns_as_are_asked_for(num_resident: int, emulator: Emulator) -> None:
    emulator.interleave(num_resident)
    assert chained(emulator, "count_resident_blocks", 9)[1] == [9, 9, num_resident]


def test_blocks_that_take_turns_show_who_does_not_wait(emulator: Emulator) -> None:
    """A chain of sums that reads once what the block before may not have published yet."""
    wanted = list(range(1, 9))
    assert chained(emulator, "chain_without_waiting", 8)[0] == wanted  # one after the other, nobody has to wait
    emulator.interleave(3)
    for seed in range(3):
        emulator.seed(seed)
        assert chained(emulator, "chain_without_waiting", 8)[0] != wanted
        assert chained(emulator, "chain_without_waiting", 8, 1)[0] == wanted


def test_who_waits_for_a_block_that_has_not_started_waits_in_vain(emulator: Emulator) -> None:
    emulator.seed(1)  # blocks that started from the last to the first would not wait in vain
    emulator.interleave(2)
    with pytest.raises(DeviceError, match="wait for what no resident block will do"):
        chained(emulator, "wait_for_the_next_block", 20)


def test_nothing_runs_before_the_host_waits(emulator: Emulator) -> None:
    array = emulator.upload(np.arange(4, dtype=np.float32))
    pinned = emulator.pinned((4,), np.float32)
    pinned.fetch(array)
    assert not pinned.values.any()
    emulator.wait()
    np.testing.assert_array_equal(pinned.values, np.arange(4))
