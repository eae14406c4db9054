"""Run pieces of work on a Dask cluster that is already there.

Files carry the data and the cluster carries numbers: a piece is a few words, and what comes back is nothing. So the scheduler
has little to do, and any worker may do any piece that sees the folder of work. Before the first piece, each worker is asked
whether it does, which version it runs, and which bits it computes. A worker that joins later is asked for its bits by the pieces
themselves.
"""

import math
import socket
import uuid
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from splatree.errors import InputError, MissingExtraError
from splatree.outofcore.fingerprint import fingerprint
from splatree.outofcore.work import Work, write_text
from splatree.version import program_version

__all__ = ["Cluster", "cluster_at"]

PATIENCE_S = 10.0
"""How long a scheduler may take to answer, and the first worker to join."""

GREETING_BYTES = 1 << 16
"""More than the first message of a scheduler has."""

RETRIES = 1
"""How often a piece that raised is tried again: another worker may do what a wrong one could not."""

SETTINGS = {
    "distributed.comm.timeouts.connect": PATIENCE_S,
    "distributed.client.heartbeat": "30s",  # nothing of what it carries is asked for
}
"""Settings of the client while it works here."""


@dataclass(frozen=True)
class Cluster:
    """What is known of a cluster whose workers have been checked."""

    executor: Executor
    """Runs the pieces."""
    num_threads: int
    """Pieces that run at the same time."""
    thread_bytes: float
    """Memory that the smallest worker has for each of its threads; infinity: no worker has a limit."""
    died: type[Exception]
    """What is raised of a piece on which one worker after the other died."""


@contextmanager
def cluster_at(address: str, work: Work) -> Iterator[Cluster]:
    """The cluster of a scheduler, for as long as the context is open; it goes on running afterwards.

    Args:
        address: of the scheduler: tcp://host:8786.
        work: the folder that all workers have to see.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there, it has no workers, or one of them cannot take part.
    """
    try:
        import dask
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise MissingExtraError("distributed", "dask", "--scheduler") from error
    _check_address(address)
    with dask.config.set(SETTINGS):
        try:
            client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"scheduler: found something at {address} that does not answer as a Dask scheduler does ({error}), wanted the "
                "address that `dask scheduler` prints"
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=PATIENCE_S)
            except TimeoutError as error:
                raise InputError(
                    f"scheduler: found no worker at {address}, wanted at least one; start some: dask worker {address}"
                ) from error
            workers = client.scheduler_info(n_workers=-1)["workers"]
            _check_workers(client, address, work)
            yield Cluster(
                executor=client.get_executor(pure=False, retries=RETRIES),
                num_threads=sum(worker["nthreads"] for worker in workers.values()),
                thread_bytes=min(
                    (worker["memory_limit"] or math.inf) / worker["nthreads"] for worker in workers.values()
                ),
                died=KilledWorker,
            )


def _check_address(address: str) -> None:
    """Refuse what is no address, or where nothing listens or something else does: Dask would wait there for ever."""
    from distributed.comm.addressing import get_address_host_port

    try:
        host, port = get_address_host_port(address)
        with socket.create_connection((host, port), PATIENCE_S) as connection:
            speaks = not address.startswith("tcp:") or _greets(connection)
    except ValueError as error:
        raise InputError(
            f"scheduler: found {address!r} ({error}), wanted an address such as tcp://10.0.0.5:8786"
        ) from error
    except OSError as error:
        raise InputError(
            f"scheduler: found nothing that listens at {address} ({error}), wanted a Dask scheduler; start one: dask scheduler"
        ) from error
    if not speaks:
        raise InputError(
            f"scheduler: found something at {address} that does not greet as a Dask scheduler does, wanted the address that "
            "`dask scheduler` prints"
        )


def _greets(connection: socket.socket) -> bool:
    """Whether the other side begins with a small message of Dask's, whose length comes first."""
    try:
        length = connection.recv(8, socket.MSG_WAITALL)
    except TimeoutError:
        return False
    return len(length) == 8 and int.from_bytes(length, "little") < GREETING_BYTES


def _check_workers(client: Any, address: str, work: Work) -> None:
    """Refuse a cluster in which not all workers would make the same files, in the same place."""
    token = uuid.uuid4().hex
    write_text(work.token, token)
    try:
        answers = client.run(_answer, str(work.token), on_error="return")
    finally:
        work.token.unlink()
    wanted = {"version": program_version(), "token": token, "fingerprint": fingerprint()}
    for worker, answer in sorted(answers.items()):
        if isinstance(answer, ModuleNotFoundError):
            raise InputError(
                f"worker {worker}: found no splatree ({answer}), wanted {wanted['version']}; install it there"
            ) from answer
        if isinstance(answer, BaseException):
            raise InputError(
                f"worker {worker}: found {type(answer).__name__} ({answer}) instead of an answer, wanted splatree "
                f"{wanted['version']}; look at its log"
            ) from answer
        for name, value in wanted.items():
            if answer[name] != value:
                raise InputError(
                    f"worker {worker}: {_WRONG[name].format(found=answer[name], wanted=value, work=work.folder)}"
                )


_WRONG = {
    "version": "found splatree {found}, wanted {wanted}; install the same version there",
    "token": "found that it does not see {work}, wanted a folder that all workers see under the same path",
    "fingerprint": "found that it computes {found} where this program computes {wanted}; wanted processors of one kind, whose "
    "parts fit together",
}
"""What is wrong with a worker that gives another answer."""


def _answer(token: str) -> dict[str, str | None]:
    """What a worker says of itself; runs there."""
    from pathlib import Path

    try:
        seen = Path(token).read_text("utf-8")
    except OSError:
        seen = None
    return {"version": program_version(), "token": seen, "fingerprint": fingerprint()}
