"""Parts made side by side, with the memory of a few."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from splatree.io.memory import Scratch
from splatree.kernels.cpu import _core

__all__ = ["affordable", "in_order"]

_COPIES = 4
"""Memory that the making of a part takes for that of its rows."""

T = TypeVar("T")
R = TypeVar("R")


def affordable(threads: int, part_bytes: int, scratch: Scratch) -> int:
    """As many of these threads as there is room for the parts that they make; at least one."""
    threads = threads or _core.hardware_threads()
    return int(max(1, min(threads, scratch.room // max(1, _COPIES * part_bytes))))


def in_order(make: Callable[[T], R], items: Sequence[T], threads: int = 0) -> Iterator[R]:
    """``make`` of each item, in order, on ``threads`` threads (0: one for each processor); at most one result for each waits."""
    threads = threads or _core.hardware_threads()
    running: deque[Future[R]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                running.append(pool.submit(make, item))
                if len(running) > threads:
                    yield running.popleft().result()
            while running:
                yield running.popleft().result()
        finally:
            for future in running:
                future.cancel()
