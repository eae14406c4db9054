"""Starting and stopping an HTTP server in a thread, and who may reach it."""

import logging
import socket
import threading
import time
from typing import Final
from urllib.parse import urlsplit

import uvicorn
from starlette.types import ASGIApp

from splatree.errors import OutputError

__all__ = ["LOOPBACK", "HttpServer", "host_name"]

LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
"""Names by which only this machine reaches itself."""


class HttpServer:
    """An application that answers at one address, in a thread of its own."""

    def __init__(self, app: ASGIApp, host: str, port: int, *, message_bytes: int = 0) -> None:
        """Take the port, 0 for any that is free.

        ``message_bytes`` is the longest message that a WebSocket may bring; 0: there are no WebSockets.

        Raises:
            OutputError: it cannot be listened on.
        """
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._socket = socket.create_server((host, port), family=family)
        except OSError as error:
            raise OutputError(
                f"{host}:{port}: cannot be listened on ({error.strerror}); choose another --port or --host"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        """Port that it listens on."""
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            server_header=False,
            ws="websockets-sansio" if message_bytes else "none",
            ws_max_size=message_bytes,
            ws_per_message_deflate=False,  # nodes and pictures do not get smaller
            timeout_graceful_shutdown=2,
        )
        self._uvicorn = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._uvicorn.run, args=([self._socket],), daemon=True, name="splatree http"
        )

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()
        while not self._uvicorn.started and self._thread.is_alive():
            time.sleep(0.01)

    def stop(self) -> None:
        """Finish what is being answered, and stop."""
        self._uvicorn.should_exit = True
        self._thread.join(10)
        self._socket.close()

    def wait(self) -> None:
        """Return when the server has stopped."""
        while self._thread.is_alive():
            self._thread.join(0.5)  # an interruption of the main thread is seen in between


def host_name(host: str) -> str:
    """The name in ``name:port``, without the brackets of IPv6; empty if there is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
