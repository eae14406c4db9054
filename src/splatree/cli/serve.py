"""``splatree serve``: streams for viewers on the web, from this machine."""

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from splatree.cli.console import Console, counted
from splatree.stream.pages import VIEWERS
from splatree.stream.serve import ServeOptions, StreamServer


@dataclass(frozen=True)
class Command:
    """Serve the streams of a folder to viewers on the web, until it is interrupted.

    The printed address lists the streams and opens them in PlayCanvas, Spark and Cesium, which the browser loads from npm. Over
    SSH, forward the port: ssh -L 8080:localhost:8080 HOST.
    """

    folder: Positional[Path]
    """Folder that splatree stream wrote, or one that holds such folders or .rad files."""
    options: Annotated[ServeOptions, arg(name="", help="")] = ServeOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


@dataclass(frozen=True)
class Result:
    """What was served."""

    address: str
    """Where."""
    streams: tuple[str, ...]
    """Manifests and files, relative to the folder."""


def run(command: Command) -> Result:
    """Serve until interrupted."""
    server = StreamServer(command.folder, command.options)
    with server, contextlib.suppress(KeyboardInterrupt):  # from here on Ctrl-C is the usual end
        server.start()
        if not command.console.quiet:
            _announce(server, command)
        server.wait()
    return Result(server.address, server.streams)


def _announce(server: StreamServer, command: Command) -> None:
    print(f"serving {command.folder} at {server.address} until interrupted (Ctrl-C)", file=sys.stderr)
    for stream in server.streams:
        viewer = next(viewer for end, viewer in VIEWERS.items() if stream.endswith(end))
        print(f"  {server.address}open/{viewer}?stream={stream}", file=sys.stderr, flush=True)


def show(result: Result) -> str:
    """The result in words."""
    return f"served {counted(len(result.streams), 'stream')} at {result.address}"
