"""Parts made side by side, with the memory of a few."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from splatree.kernels.cpu import _core

__all__ = ["in_order"]

T = TypeVar("T")
R = TypeVar("R")


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
