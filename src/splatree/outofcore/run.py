"""Run pieces of work on an executor: the one place where it matters who does them.

Any executor of `concurrent.futures` will do, on this machine or on others that see the same files. A piece reads and writes
files, returns nothing and may be done twice. Its mark says that it is done, so a piece with a mark is not run again.
"""

import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from splatree.errors import InputError
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.grow import grow_cell, grow_cell_by_pairs, grow_crown
from splatree.outofcore.plan import Plan, read_plan
from splatree.outofcore.shuffle import cell_sizes, make_cell
from splatree.outofcore.sight import look_along
from splatree.outofcore.thin_cell import count_cell, thin_cell
from splatree.outofcore.work import Work
from splatree.progress import task

__all__ = ["Workers", "run_cells", "run_pieces"]

TRIES = 2
"""How often processes may die before the build gives up."""


@dataclass(frozen=True)
class _Kind:
    """A kind of piece."""

    says: str
    """What the user reads while it is done."""
    do: Callable[[Work, Plan, int, Any, int], dict[str, Any]]
    """Does the piece of a cell, given its argument and the number of threads; returns what the client has to know."""


KINDS = {
    "cell": _Kind("put cells in order", make_cell),
    "sight": _Kind("measure what is seen", look_along),
    "grow": _Kind("grow cells", grow_cell),
    "grow-pairs": _Kind("grow cells", grow_cell_by_pairs),
    "crown": _Kind("grow levels above", grow_crown),
    "count": _Kind("count what a radius leaves", count_cell),
    "thin": _Kind("thin cells", thin_cell),
}
"""All kinds of pieces."""


@dataclass(frozen=True)
class Workers:
    """Who runs the pieces: this process, processes of its own, or an executor that is given."""

    num_workers: int
    """Processes to start, if no executor is given; 1: this process."""
    executor: Executor | None = None
    """The executor that is given."""
    died: type[Exception] = BrokenProcessPool
    """What the executor raises of a piece whose process died."""

    @property
    def threads(self) -> int:
        """Threads that a piece may use; 0: all of the machine."""
        return 0 if self.num_workers == 1 and self.executor is None else 1

    @contextmanager
    def pool(self) -> Iterator[Executor | None]:
        """The executor; None: run in this process."""
        if self.executor is not None or self.num_workers == 1:
            yield self.executor
            return
        # Spawned: a forked process would inherit what this one has in memory, and its threads' locks.
        with ProcessPoolExecutor(
            self.num_workers, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN)
        ) as executor:
            others = set(active_children())
            with _interruptions_held():
                for _ in range(self.num_workers):
                    executor.submit(int)  # starts a process
            started = set(active_children()) - others
            try:
                yield executor
            except KeyboardInterrupt:  # what they are doing has no mark, and is done again
                executor.shutdown(wait=False, cancel_futures=True)
                for process in started:
                    process.terminate()
                raise


@contextmanager
def _interruptions_held() -> Iterator[None]:
    """Let Ctrl-C wait until the end of the block; of processes that are started in it, it never reaches any."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run_cells(work: Work, plan: Plan, kind: str, workers: Workers, *, argument: float = 0) -> list[dict[str, Any]]:
    """Do one kind of piece for all cells that have no mark for it: `run_pieces` with the rows of each cell."""
    return run_pieces(work, plan, kind, workers, [float(size) for size in cell_sizes(work, plan)], argument=argument)


def run_pieces(
    work: Work, plan: Plan, kind: str, workers: Workers, sizes: Sequence[float], *, argument: float = 0
) -> list[dict[str, Any]]:
    """Do the pieces of one kind that have no mark.

    Args:
        work: where the pieces are.
        plan: what was decided for the whole scene.
        kind: a name in `KINDS`.
        workers: who does them.
        sizes: rows that each piece goes through.
        argument: what the kind of piece needs to know besides.

    Returns:
        What came of each piece, in their order.

    Raises:
        InputError: processes died again and again, or a piece is said to be done and its mark is not there; they are named.
    """
    pieces = range(len(sizes))
    names = [_name(kind, number, argument) for number in pieces]
    jobs = [(str(work.folder), plan.run, kind, number, argument, workers.threads) for number in pieces]
    missing = [number for number in pieces if work.result(names[number], plan.run) is None]
    total = sum(sizes)
    with task(KINDS[kind].says, total, done=total - sum(sizes[number] for number in missing)) as advance:

        def ended(number: int) -> None:
            advance(sizes[number])

        for _ in range(TRIES):
            if missing:
                with workers.pool() as executor:
                    missing = _run(executor, {number: jobs[number] for number in missing}, workers, ended)
                missing = [number for number in missing if work.result(names[number], plan.run) is None]
        if missing:
            raise InputError(
                f"cells {missing[:8]}: found that the processes which worked on them died {TRIES} times, perhaps for lack of "
                "memory; run the build again with a smaller --part-rows or fewer --workers, it goes on where it stopped"
            )
    results = {number: work.result(name, plan.run) for number, name in zip(pieces, names, strict=True)}
    if lost := [number for number, result in results.items() if result is None]:
        raise InputError(
            f"cells {lost[:8]}: found no mark in {work.folder} of what workers say they did, wanted a folder that is the same "
            "for all of them; run the build again, it goes on where it stopped"
        )
    return [result for result in results.values() if result is not None]


def _run(
    executor: Executor | None,
    jobs: Mapping[int, tuple[Any, ...]],
    workers: Workers,
    ended: Callable[[int], None],
) -> list[int]:
    """Do the jobs of some cells, and tell of each that has ended; returns the cells whose processes died."""
    if executor is None:
        for number, job in jobs.items():
            do_piece(*job)
            ended(number)
        return []
    futures: dict[Future[None], int] = {}
    missing = []
    try:
        for number, job in jobs.items():
            futures[executor.submit(do_piece, *job)] = number
        for future in as_completed(futures):
            if isinstance(future.exception(), workers.died):
                missing.append(futures[future])
            else:
                future.result()
                ended(futures[future])
    except workers.died:  # while pieces were handed out: what is done has a mark
        missing = list(jobs)
    except BaseException as error:
        if isinstance(error, Exception) or workers.executor is not None:  # else `Workers.pool` ends its processes
            for future in futures:
                future.cancel()
        raise
    return sorted(missing)


def do_piece(folder: str, run: str, kind: str, number: int, argument: float, threads: int) -> None:
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
    name = _name(kind, number, argument)
    if work.result(name, run) is None:
        work.finish(name, run, KINDS[kind].do(work, plan, number, argument, threads))


def _name(kind: str, number: int, argument: float) -> str:
    """Of a piece, in the name of its mark; a cell that grows to other levels is another piece."""
    return f"{kind}-{argument!r}-{number:05}"


@lru_cache(maxsize=1)
def _plan_of(folder: str, run: str) -> Plan:
    """Read once in each process; ``run`` tells plans of one folder apart."""
    return read_plan(Work(Path(folder)))
