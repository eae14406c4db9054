"""A server of streams: files by ranges of bytes, for pages of any origin, and links that open them in viewers.

Only files whose suffix is of a stream are served, only from inside the folder, links followed; folders are not listed. Units
whose name holds a digest may be cached for ever, all else is asked for again. On this machine alone the server answers to names
of this machine only, so that no other site can point a name of its own here. Reached from other machines, every address begins
with a random token.
"""

import gzip
import os
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final, Self
from urllib.parse import urlencode

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from splatree.errors import InputError, SplatreeError
from splatree.scene.arguments import checked
from splatree.scene.given import given
from splatree.scene.literals import check_literals
from splatree.stream.first_view import first_view
from splatree.stream.http import LOOPBACK, HttpServer, host_name
from splatree.stream.pages import VIEWERS, index_page, viewer_page

__all__ = ["ServeOptions", "StreamServer", "serve"]

TYPES: Final = {
    ".json": "application/json",
    ".webp": "image/webp",
    ".glb": "model/gltf-binary",
    ".rad": "application/octet-stream",
    ".radc": "application/octet-stream",
    ".sog": "application/zip",
    ".ssog": "application/zip",
}
"""Suffixes of streams."""

GZIP_LEVEL: Final = 6
"""Of manifests, which come down to a fifth."""

_PAGE_TYPES: Final = {
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".css": "text/css",
    ".wasm": "application/wasm",
}
_DIGEST = re.compile(r"-[0-9a-f]{12}([./]|$)")
_GZIP = re.compile(r"\bgzip\b(?!\s*;\s*q=0(\.0*)?\s*(,|$))")
_FOR_EVER = "public, max-age=31536000, immutable"


@dataclass(frozen=True)
class ServeOptions:
    """Where streams are served, and where viewers come from.

    Example:
        >>> st.ServeOptions(host="0.0.0.0").is_local
        False
    """

    host: str = "127.0.0.1"
    """Address to listen on. For any address but this machine's own, the printed address has a token."""
    port: int = 8080
    """Port to listen on; 0: any port that is free."""
    packages: str = "https://cdn.jsdelivr.net/npm"
    """Where the browser loads PlayCanvas, Spark and Cesium from: an address with npm packages, or a folder node_modules."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 0 <= self.port <= 65535:
            raise InputError(f"port: found {self.port}, wanted 0 to 65535")
        if not self.host or not self.packages:
            raise InputError(
                f"host, packages: found {self.host!r}, {self.packages!r}, wanted addresses, such as 127.0.0.1"
            )

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the server."""
        return self.host in LOOPBACK


class StreamServer:
    """A server of the streams in one folder; `serve` starts one.

    Example:
        >>> written = st.stream(scene, "city_stream")
        >>> server = st.serve("city_stream", st.ServeOptions(port=0))
        >>> server.address.endswith("/")
        True
        >>> server.stop()
    """

    def __init__(self, folder: Path, options: ServeOptions) -> None:
        """Take the port.

        Raises:
            InputError: the folder is none, or holds no stream.
            OutputError: the port cannot be listened on.
        """
        if folder.is_file():
            raise InputError(f"{folder}: is a file, wanted {_folder_for(folder)}")
        if not folder.is_dir():
            raise InputError(f"{folder}: not found; wanted a folder that holds a stream")
        self.folder = folder.resolve()
        self.streams = tuple(streams_in(self.folder))
        if not self.streams:
            raise InputError(
                f"{folder}: found no lod-meta.json, tileset.json or .rad in it or in the folders inside, links out of it not "
                f"counted; write a stream with splatree stream scene.splatree {folder}"
            )
        self._views: dict[str, dict[str, str]] = {}
        self._options = options
        self._prefix = "" if options.is_local else f"/{secrets.token_urlsafe(16)}"
        packages = Path(options.packages)
        self._packages = None if "://" in options.packages else packages.resolve()
        if self._packages is not None and not self._packages.is_dir():
            raise InputError(f"packages: found {options.packages}, wanted an address or a folder node_modules")
        routes: list[BaseRoute] = [
            Route("/", self._index),
            Route("/open/{viewer}", self._viewer),
            Route("/page/{name}", self._page),
            Route("/packages/{path:path}", self._package),
            Route("/{path:path}", self._file),
        ]
        cors = Middleware(
            CORSMiddleware,
            allow_origins=["*"],
            allow_methods=["GET", "HEAD"],
            allow_headers=["*"],
            expose_headers=["*"],
            allow_private_network=True,
        )
        app: ASGIApp = Starlette(
            routes=[Mount(self._prefix, routes=routes)] if self._prefix else routes, middleware=[cors]
        )
        self._http = HttpServer(_LocalNames(app) if options.is_local else app, options.host, options.port)

    @property
    def address(self) -> str:
        """Where the server answers."""
        host = f"[{self._options.host}]" if ":" in self._options.host else self._options.host
        return f"http://{host}:{self._http.port}{self._prefix}/"

    def start(self) -> None:
        """Begin to answer."""
        self._http.start()

    def stop(self) -> None:
        """Stop."""
        self._http.stop()

    def wait(self) -> None:
        """Return when the server has stopped."""
        self._http.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    async def _index(self, request: Request) -> Response:
        return HTMLResponse(index_page(self.folder.name, self.streams), headers={"Cache-Control": "no-store"})

    def _viewer(self, request: Request) -> Response:
        asked = dict(request.query_params)
        view = self._view_of(asked["stream"]) if asked.get("stream") in self.streams else {}
        if "pos" in asked:  # the camera is that of the address, the mode is that of the stream
            view = {name: said for name, said in view.items() if name == "mode"}
        if not asked.keys() >= view.keys():
            return RedirectResponse(f"?{urlencode(view | asked)}", headers={"Cache-Control": "no-store"})
        base = f"{self._prefix}/packages" if self._packages is not None else self._options.packages
        text = viewer_page(request.path_params["viewer"], base, has_versions=self._packages is None)
        if text is None:
            return _not_found()
        return HTMLResponse(text, headers={"Cache-Control": "no-store"})

    def _view_of(self, stream: str) -> dict[str, str]:
        """What the address of a page says of the first view and the mode; nothing of a stream that cannot be read here."""
        if _file_in(self.folder, stream) is None:  # it was taken away meanwhile
            return {}
        if stream not in self._views:
            try:
                framing, mode = first_view(self.folder / stream)
            except (
                SplatreeError,
                OSError,
                KeyError,
                TypeError,
                ValueError,
            ):  # of other tools: their pages choose a view
                self._views[stream] = {}
            else:
                vectors = {"pos": framing.eye, "target": framing.target, "up": framing.up}
                words = {name: ",".join(f"{x:.7g}" for x in vector) for name, vector in vectors.items()}
                self._views[stream] = words | {"fov": f"{framing.fov_y_deg:g}", "mode": mode, "turn": "1"}
        return self._views[stream]

    async def _page(self, request: Request) -> Response:
        name = request.path_params["name"]
        found = files("splatree.stream") / "page" / name
        if not re.fullmatch(r"[a-z]+\.(js|css)", name) or not found.is_file():
            return _not_found()
        media = _PAGE_TYPES[f".{name.rpartition('.')[2]}"]
        return Response(found.read_bytes(), media_type=media, headers={"Cache-Control": "no-cache"})

    async def _package(self, request: Request) -> Response:
        if self._packages is None:
            return _not_found()
        return _answer(self._packages, request, TYPES | _PAGE_TYPES | {".svg": "image/svg+xml", ".png": "image/png"})

    def _file(self, request: Request) -> Response:
        return _answer(self.folder, request, TYPES)


@checked
def serve(folder: str | os.PathLike[str], options: ServeOptions | None = None) -> StreamServer:
    """Serve the streams of a folder to viewers on the web, in a thread of its own.

    Args:
        folder: the folder that `stream` wrote, or one that holds such folders or ``.rad`` files.
        options: address, port, and where viewers come from; None: the defaults.

    Returns:
        The running server. Its ``address`` lists the streams and the viewers that open them.

    Raises:
        InputError: the folder holds no stream.
        OutputError: the port cannot be listened on.

    Example:
        >>> written = st.stream(scene, "city_stream")
        >>> server = st.serve("city_stream", st.ServeOptions(port=0))
        >>> server.address.startswith("http://127.0.0.1:")
        True
        >>> server.stop()
    """
    server = StreamServer(Path(folder), given(options, ServeOptions, "serve: options"))
    server.start()
    return server


def _folder_for(file: Path) -> str:
    """What to serve in place of a file."""
    if file.suffix == ".rad" or file.name in VIEWERS:
        return f"the folder around it: splatree serve {file.parent}"
    return f"a folder that holds a stream; write one with splatree stream {file} {file.stem}_stream"


def streams_in(folder: Path) -> Iterator[str]:
    """Manifests and files of streams in a folder and in the folders inside, relative to it, sorted."""
    patterns = [f"{inside}{name}" for inside in ("", "*/") for name in ("lod-meta.json", "tileset.json", "*.rad")]
    found = {path.relative_to(folder).as_posix() for pattern in patterns for path in folder.glob(pattern)}
    yield from sorted(name for name in found if _file_in(folder.resolve(), name) is not None)


class _LocalNames:
    """Refuses requests under names that are not this machine's own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            host = next((value for name, value in scope["headers"] if name == b"host"), b"").decode("latin-1")
            if host_name(host) not in LOOPBACK:
                refusal = f"found Host {host[:80]!r}, wanted a name of this machine, such as localhost\n"
                await PlainTextResponse(refusal, 403)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def _file_in(root: Path, path: str) -> Path | None:
    """The file of a path below a folder; None if there is none that can be read, or a link leads to it out of the folder."""
    target = Path(os.path.realpath(root / path.lstrip("/"))) if "\0" not in path else root
    try:
        is_file = target.is_relative_to(root) and target.is_file() and os.access(target, os.R_OK)
    except OSError:  # a name that is too long
        return None
    return target if is_file else None


def _answer(root: Path, request: Request, types: dict[str, str]) -> Response:
    """A file below a folder, whole or a range of it."""
    path = request.path_params["path"]
    target = _file_in(root, path)
    if target is None or target.suffix not in types:
        return _not_found()
    caching = _FOR_EVER if _DIGEST.search(path) else "no-cache"
    headers = {
        "Cache-Control": caching,
        "Cross-Origin-Resource-Policy": "cross-origin",
        "X-Content-Type-Options": "nosniff",
    }
    found = FileResponse(target, headers=headers, media_type=types[target.suffix], stat_result=target.stat())
    tag, is_text = found.headers["etag"], target.suffix == ".json"  # all else is compressed already
    if is_text:
        headers["Vary"] = found.headers["vary"] = "Accept-Encoding"
    is_packed = is_text and "range" not in request.headers and _GZIP.search(request.headers.get("accept-encoding", ""))
    if is_packed:
        tag = f'{tag[:-1]}-gzip"'  # other bytes
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers | {"ETag": tag})
    if not is_packed:
        return found
    packed = gzip.compress(target.read_bytes(), GZIP_LEVEL, mtime=0)
    return Response(packed, headers=headers | {"Content-Encoding": "gzip", "ETag": tag}, media_type=types[".json"])


def _not_found() -> Response:
    return PlainTextResponse("not found\n", 404)
