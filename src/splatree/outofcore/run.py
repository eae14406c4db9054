"""Run pieces of work on an executor: the one place where it matters who does them.

Any executor of `concurrent.futures` will do, on this machine or on others that see the same files. A piece reads and writes
files, returns nothing and may be done twice. Its mark says that it is done, so a piece with a mark is not run again.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from splatree.errors import InputError
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.grow import grow_cell
from splatree.outofcore.plan import Plan, read_plan
from splatree.outofcore.shuffle import make_cell
from splatree.outofcore.work import Work
from splatree.progress import task

__all__ = ["Workers", "run_cells"]

TRIES = 2
"""How often a pool of processes may break before the build gives up."""


class Workers:
    """Who runs the pieces: this process, processes of its own, or an executor that is given."""

    def __init__(self, num_workers: int, executor: Executor | None) -> None:
        self.num_workers = num_workers
        """Pieces at the same time."""
        self._given = executor

    @contextmanager
    def pool(self) -> Iterator[Executor | None]:
        """The executor; None: run in this process."""
        if self._given is not None or self.num_workers == 1:
            yield self._given
            return
        # Spawned: a forked process would inherit what this one has in memory, and its threads' locks.
        with ProcessPoolExecutor(self.num_workers, mp_context=get_context("spawn")) as executor:
            yield executor


def run_cells(
    work: Work, plan: Plan, kind: str, workers: Workers, *, num_levels: int = 0, threads: int = 0
) -> list[dict[str, Any]]:
    """Do one kind of piece, ``cell`` or ``grow``, for all cells that have no mark for it.

    Returns:
        What came of each cell, in their order.

    Raises:
        InputError: processes died again and again; the cells that were not done are named.
    """
    cells = range(len(plan.cells))
    names = [_name(kind, number, num_levels) for number in cells]
    jobs = [(str(work.folder), plan.run, kind, number, num_levels, threads) for number in cells]
    say = {"cell": "put cells in order", "grow": "grow cells"}[kind]
    with task(say, float(len(cells))) as advance:
        missing = [number for number in cells if work.result(names[number], plan.run) is None]
        advance(float(len(cells) - len(missing)))
        for _ in range(TRIES):
            try:
                with workers.pool() as executor:
                    _run(executor, do_piece, [jobs[number] for number in missing], advance)
                missing = []
                break
            except BrokenProcessPool:
                missing = [number for number in missing if work.result(names[number], plan.run) is None]
        if missing:
            raise InputError(
                f"cells {missing[:8]}: found that the processes which worked on them died {TRIES} times, perhaps for lack of "
                "memory; run the build again with a smaller --max-memory or fewer --workers, it goes on where it stopped"
            )
    results = [work.result(name, plan.run) for name in names]
    return [result for result in results if result is not None]


def _run(
    executor: Executor | None,
    function: Callable[..., None],
    jobs: Sequence[tuple[Any, ...]],
    advance: Callable[[float], None],
) -> None:
    if executor is None:
        for job in jobs:
            function(*job)
            advance(1.0)
        return
    futures: list[Future[None]] = [executor.submit(function, *job) for job in jobs]
    try:
        for future in as_completed(futures):
            future.result()
            advance(1.0)
    finally:
        for future in futures:
            future.cancel()


def do_piece(folder: str, run: str, kind: str, number: int, num_levels: int, threads: int) -> None:
    """Do one piece, unless it is done, and mark it; runs in any process that sees the folder.

    Raises:
        InputError: this process computes other bits than the one that made the plan.
    """
    work = Work(Path(folder))
    plan = _plan_of(folder, run)
    if plan.fingerprint != fingerprint():
        raise InputError(
            f"worker: found that it computes {fingerprint()} where the build began with {plan.fingerprint}; wanted processes of "
            "one version on processors of one kind, whose parts fit together"
        )
    name = _name(kind, number, num_levels)
    if work.result(name, run) is not None:
        return
    if kind == "cell":
        make_cell(work, plan, number)
        work.finish(name, run, {})
    else:
        work.finish(name, run, grow_cell(work, plan, number, num_levels, threads))


def _name(kind: str, number: int, num_levels: int) -> str:
    """Of a piece, in the name of its mark; a cell that grows to other levels is another piece."""
    return f"{kind}-{number:05}" if kind == "cell" else f"{kind}-{num_levels}-{number:05}"


@lru_cache(maxsize=1)
def _plan_of(folder: str, run: str) -> Plan:
    """Read once in each process; ``run`` tells plans of one folder apart."""
    return read_plan(Work(Path(folder)))
