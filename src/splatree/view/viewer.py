"""`view`: look at a scene in a browser, from Python and in notebooks."""

import contextlib
import secrets
import sys
import threading
import webbrowser
from collections.abc import Mapping, Sequence
from types import TracebackType

from splatree.errors import InputError
from splatree.outofcore.store import Store
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.given import given
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.view.exhibit import exhibit
from splatree.view.options import ViewOptions
from splatree.view.server import Server

__all__ = ["Viewer", "view"]


@checked
def view(
    scene: Scene | Store,
    options: ViewOptions | None = None,
    *,
    beside: Scene | Store | None = None,
    cameras: Cameras | Sequence[Camera] | None = None,
    photos: Mapping[str, Array] | None = None,
    block: bool | None = None,
    open_browser: bool | None = None,
) -> "Viewer":
    """Show a scene in the browser.

    The cut of each view is made here and the browser draws it. A scene of more than 50,000 Gaussians without levels of detail
    gets them first.

    Args:
        scene: what is shown; of a store only the pages are read that views need.
        options: where, and with how many nodes; None: the defaults.
        beside: another scene to compare it with, under the same camera.
        cameras: views listed in the page, for instance those of the training.
        photos: their photographs by the camera's name, float32 "h w 3".
        block: wait until interrupted (Ctrl-C); False returns at once and the viewer goes on until it is closed. None: wait,
            except in a notebook.
        open_browser: open the address in a browser; None: only if it waits.

    Returns:
        The viewer; as the last value of a notebook's cell it shows the scene there.

    Raises:
        InputError: the scene is empty, was not read from a file and holds what is not finite, or is a store and occlusion is
            asked for.
        OutputError: the port cannot be listened on.

    Example:
        >>> viewer = st.view(scene, block=False)  # doctest: +SKIP
        >>> viewer.set_scene(st.thin(scene.gaussians).gaussians)  # doctest: +SKIP
    """
    viewer = Viewer(scene, options, beside=beside, cameras=cameras, photos=photos)
    waits = not _in_notebook() if block is None else block
    is_opened = waits if open_browser is None else open_browser
    if not waits:
        if is_opened:
            webbrowser.open(viewer.url)
        return viewer
    with viewer, contextlib.suppress(KeyboardInterrupt):  # from here on Ctrl-C is the usual end
        print(f"look at {viewer.url} (Ctrl-C ends it)", flush=True)
        if is_opened:
            webbrowser.open(viewer.url)
        viewer.wait()
    return viewer


def _in_notebook() -> bool:
    """Whether a notebook's kernel runs this: the value of a cell is shown when the cell ends."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


class Viewer:
    """A scene on show in browsers; `view` makes it.

    Example:
        >>> with st.view(scene, block=False) as viewer:
        ...     viewer.num_nodes == len(scene)
        True
    """

    def __init__(
        self,
        scene: Scene | Store,
        options: ViewOptions | None = None,
        *,
        beside: Scene | Store | None = None,
        names: tuple[str, ...] = ("scene", "beside"),
        cameras: Cameras | Sequence[Camera] | None = None,
        photos: Mapping[str, Array] | None = None,
    ) -> None:
        self.options = given(options, ViewOptions, "view: options")
        for shown, name in zip((scene, beside), names, strict=False):
            if self.options.occlusion and isinstance(shown, Store):
                raise InputError(
                    f"occlusion: found {name} read page by page, wanted a scene in memory, of which a first picture is drawn; "
                    "leave it out, or read the scene whole"
                )
        device = self.options.device
        exhibits = [exhibit(scene, names[0], up=self.options.up, device=device)]
        if beside is not None:
            exhibits.append(exhibit(beside, names[1], framing=exhibits[0].framing, device=device))
        self._first = exhibits[0].framing.camera()
        self._token = None if self.options.is_local else secrets.token_urlsafe(16)
        self._server = Server(exhibits, self.options, self._token, cameras, photos)
        self._closed = threading.Event()
        self._server.start()

    @property
    def url(self) -> str:
        """Address of the page; it holds the token, where one is needed."""
        host = "127.0.0.1" if self.options.host in ("0.0.0.0", "::") else self.options.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self._server.port}/" + (f"?token={self._token}" if self._token else "")

    @property
    def port(self) -> int:
        """Port that it listens on."""
        return self._server.port

    @property
    def num_nodes(self) -> int:
        """Nodes of the scene that is shown, with levels that were built for it."""
        return self._server.exhibits[0].shown.num_nodes

    @property
    def camera(self) -> Camera:
        """The view of the page that moved last; the first view if none is connected. Set it to move all pages."""
        clients = [client for client in self._server.clients() if client.camera is not None]
        newest = max(clients, key=lambda client: client.seen_s, default=None)
        return self._first if newest is None or newest.camera is None else newest.camera

    @camera.setter
    def camera(self, camera: Camera) -> None:
        for client in self._server.clients():
            client.look(camera)

    def set_scene(self, scene: Scene | Store, *, beside: bool = False) -> None:
        """Show another scene in the place of the first one, or of the one beside it; pages keep their cameras.

        Raises:
            InputError: the scene is empty, or there is none beside the first.
        """
        which = int(beside)
        shown = self._server.exhibits
        if which >= len(shown):
            raise InputError("set_scene: found no scene beside the first; name one when the viewer is made")
        old = shown[which]
        new = exhibit(scene, old.name, framing=old.framing, device=self.options.device)
        self._server.show(which, new)

    def wait(self) -> None:
        """Wait until `close` is called, or Ctrl-C."""
        while not self._closed.wait(1.0):
            pass

    def close(self) -> None:
        """Let all pages go and stop listening."""
        self._closed.set()
        self._server.stop()

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return (
            f'<iframe src="{self.url}" width="100%" height="560" style="border:0;border-radius:8px" allow="fullscreen">'
            f'</iframe><div><a href="{self.url}" target="_blank">open in a tab</a></div>'
        )

    def __repr__(self) -> str:
        return f"Viewer({self.url!r})"
