"""The connection of one page: what it says goes to its worker, what the worker sends goes to it.

The worker has a thread of its own, which ends when the page is gone. That a page is gone, or takes nothing in, is no error; any
other failure of a worker is logged, and closes the connection with the code for an internal error.
"""

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect

from splatree.errors import InputError
from splatree.view.client import PATIENCE_S, Client

__all__ = ["IDLE_S", "IdleError", "carry", "send_from_thread"]

IDLE_S: Final = 600.0
"""A page that says nothing for so long is let go; it connects again when it is used."""

REFUSED, IDLE, FAILED, GONE = 1008, 4000, 1011, 1000
"""Codes of closing: the page said what no page says; it said nothing; the worker failed; it left or took nothing in."""

REASON_BYTES = 120
"""A reason has at most 123 bytes (RFC 6455)."""


class IdleError(Exception):
    """The page says nothing."""


async def carry(socket: WebSocket, client: Client) -> None:
    """Let a page and its worker talk until either ends, and close the connection with a reason."""
    loop = asyncio.get_running_loop()
    work = _in_thread(loop, client.run)
    listening = asyncio.ensure_future(_listen_to(socket, client))
    await asyncio.wait({work, listening}, return_when=asyncio.FIRST_COMPLETED)
    client.close()
    code, reason = GONE, ""
    if listening.done():
        error = listening.exception()
        if error is not None:
            code, reason = (IDLE if isinstance(error, IdleError) else REFUSED), str(error)
    else:
        listening.cancel()
    if work.done() and (failure := work.exception()) is not None and not _is_gone(failure):
        logging.getLogger("splatree.view").error("the worker of a page failed", exc_info=failure)
        code, reason = FAILED, f"the server failed: {failure}"
    reason = reason.encode()[:REASON_BYTES].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, TimeoutError, WebSocketDisconnect):  # it may be gone already
        await asyncio.wait_for(socket.close(code, reason), 2)
    await asyncio.gather(work, listening, return_exceptions=True)


def send_from_thread(loop: asyncio.AbstractEventLoop, socket: WebSocket, data: bytes) -> None:
    """Send and wait until the connection has taken the data.

    Raises:
        TimeoutError: it does not within half a minute.
        WebSocketDisconnect, RuntimeError: the page or the server is gone.
    """
    asyncio.run_coroutine_threadsafe(socket.send_bytes(data), loop).result(PATIENCE_S)


async def _listen_to(socket: WebSocket, client: Client) -> None:
    """Hand on what the page says.

    Raises:
        InputError: it says what no page says.
        IdleError: it says nothing for ten minutes.
    """
    while True:
        try:
            text = await asyncio.wait_for(socket.receive_text(), IDLE_S)
        except TimeoutError:
            raise IdleError("idle: the page said nothing for ten minutes") from None
        except WebSocketDisconnect:
            return
        except KeyError:
            raise InputError("message: found bytes, wanted a text") from None
        client.receive(text)


def _in_thread(loop: asyncio.AbstractEventLoop, work: Callable[[], None]) -> "asyncio.Future[None]":
    """Run in a thread that does not keep the program alive; the future is done when it ends."""
    done: asyncio.Future[None] = loop.create_future()

    def finish(error: Exception | None) -> None:
        if error is None:
            done.set_result(None)
        else:
            done.set_exception(error)

    def run() -> None:
        error = None
        try:
            work()
        except Exception as failure:
            error = failure
        with contextlib.suppress(RuntimeError):  # the server has stopped: nobody waits
            loop.call_soon_threadsafe(finish, error)

    threading.Thread(target=run, daemon=True, name="splatree view client").start()
    return done


def _is_gone(error: BaseException) -> bool:
    """Whether a worker ended because the page or the server is gone."""
    return isinstance(error, TimeoutError | WebSocketDisconnect | RuntimeError) and not isinstance(
        error, RecursionError
    )
