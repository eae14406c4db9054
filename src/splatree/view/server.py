"""HTTP and WebSockets of the viewer (Starlette on uvicorn), in a thread of its own.

``/`` is the page, ``/page/NAME`` its files, ``/cameras.json`` the views of a file, ``/photo/NUMBER`` their photographs, ``/ws``
the connection of a page. Files are served from a list that is made when the server starts: no path of a request is ever opened.
"""

import asyncio
import io
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from starlette.applications import Starlette
from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from splatree.scene.cameras import Camera, Cameras
from splatree.shapes import Array
from splatree.stream.http import HttpServer
from splatree.view.client import Client
from splatree.view.connection import carry, send_from_thread
from splatree.view.exhibit import Exhibit
from splatree.view.files import index_of, page_files, policy
from splatree.view.guard import Guard
from splatree.view.messages import TEXT_BYTES
from splatree.view.options import CAPACITY, ViewOptions

__all__ = ["Server"]

CLIENTS_MAX: Final = 16
"""Pages that are connected at once."""

PHOTO_PX: Final = 1600
"""Longer side of a photograph as it is sent."""

SAFE: Final = {"X-Content-Type-Options": "nosniff", "Cross-Origin-Resource-Policy": "same-origin"}
"""Headers of every file."""


class Server:
    """The server of one viewer."""

    def __init__(
        self,
        exhibits: list[Exhibit],
        options: ViewOptions,
        token: str | None,
        cameras: Cameras | Sequence[Camera] | None = None,
        photos: Mapping[str, Array] | None = None,
    ) -> None:
        self.exhibits, self._options, self._token = exhibits, options, token
        self._cameras, self._photos = cameras, photos
        self._files = page_files()
        self._lock = threading.Lock()
        self._clients: list[tuple[int, Client]] = []
        routes = [
            Route("/", self._index),
            Route("/page/{name}", self._file),
            Route("/cameras.json", self._views),
            Route("/photo/{number:int}", self._photo),
            WebSocketRoute("/ws", self._connect),
        ]
        app = Guard(Starlette(routes=routes), options, token)
        self._http = HttpServer(app, options.host, options.port, message_bytes=TEXT_BYTES)
        self.port: int = self._http.port
        """Port that it listens on."""

    def start(self) -> None:
        """Begin to answer."""
        self._http.start()

    def stop(self) -> None:
        """Let all pages go and stop."""
        with self._lock:
            clients = list(self._clients)
        for _, client in clients:
            client.close()
        self._http.stop()
        for exhibit in self.exhibits:
            exhibit.session.close()

    def show(self, which: int, exhibit: Exhibit) -> None:
        """Show another scene in the place ``which``."""
        self.exhibits[which] = exhibit
        for client in self.clients(which):
            client.show(exhibit)

    def clients(self, which: int = 0) -> list[Client]:
        """Workers of the pages that show the scene ``which``."""
        with self._lock:
            return [client for place, client in self._clients if place == which]

    async def _index(self, request: HttpRequest) -> Response:
        settings = {
            "budget": self._options.budget,
            "tau": self._options.pixel_error,
            "db": self._options.quality,
            "occlusion": self._options.occlusion,
            "frames": self._options.frames,
            "scenes": [exhibit.name for exhibit in self.exhibits],
            "capacity": CAPACITY,
        }
        headers = {
            "Content-Security-Policy": policy(self._options, request.headers.get("host", "")),
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
            **SAFE,
        }
        return Response(index_of(self._files["index.html"][0], settings), media_type="text/html", headers=headers)

    async def _file(self, request: HttpRequest) -> Response:
        found = self._files.get(request.path_params["name"])
        if found is None:
            return PlainTextResponse("not found\n", 404)
        headers = {"Cache-Control": "no-cache", **SAFE}
        return Response(found[0], media_type=found[1], headers=headers)

    async def _views(self, request: HttpRequest) -> Response:
        views = [] if self._cameras is None else list(self._cameras)
        centre = self.exhibits[0].centre
        return JSONResponse([_view(camera, centre, camera.name in (self._photos or {})) for camera in views])

    async def _photo(self, request: HttpRequest) -> Response:
        number = request.path_params["number"]
        if self._photos is None or self._cameras is None or not 0 <= number < len(self._cameras):
            return PlainTextResponse("not found\n", 404)
        name = self._cameras[number].name
        if name not in self._photos:
            return PlainTextResponse("not found\n", 404)
        photos = self._photos
        data = await asyncio.get_running_loop().run_in_executor(None, lambda: _jpeg(photos[name]))
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=600", **SAFE})

    async def _connect(self, socket: WebSocket) -> None:
        try:
            which = int(socket.query_params.get("scene", "0"))
            capacity = int(socket.query_params.get("capacity", str(CAPACITY)))
        except ValueError:
            which = capacity = -1
        if not (0 <= which < len(self.exhibits) and 1 << 16 <= capacity <= CAPACITY):
            await socket.close(1008, "scene or capacity: found none that there is")
            return
        await socket.accept()
        loop = asyncio.get_running_loop()
        if (
            len(self._clients) >= CLIENTS_MAX
        ):  # before anything is made for this one; the loop's thread alone adds pages
            await socket.close(1013, f"{CLIENTS_MAX} pages are connected already; close one")
            return
        client = Client(self.exhibits[which], lambda data: send_from_thread(loop, socket, data), capacity)
        with self._lock:
            self._clients.append((which, client))
        try:
            await carry(socket, client)
        finally:
            client.close()
            with self._lock:
                self._clients = [entry for entry in self._clients if entry[1] is not client]


def _view(camera: Camera, centre: Array, has_photo: bool) -> dict[str, Any]:
    pose = np.linalg.inv(camera.camera_from_world)
    pose[:3, 3] -= centre
    return {
        "name": camera.name,
        "c2w": pose[:3].ravel().tolist(),
        "f": float(camera.K[1, 1]),
        "w": camera.width,
        "h": camera.height,
        "photo": has_photo,
    }


def _jpeg(image: Array) -> bytes:
    from PIL import Image

    picture = Image.fromarray(np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8))
    picture.thumbnail((PHOTO_PX, PHOTO_PX))
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=85)
    return file.getvalue()
