"""A view that was asked for ahead: its picture is waited for when it is needed."""

import threading
from collections.abc import Callable

from splatree.errors import SplatreeError
from splatree.scene.frame import RenderResult

__all__ = ["Pending"]


class Pending:
    """A view that a session was asked to draw.

    Example:
        >>> with st.open_session(scene) as session:
        ...     pending = [session.enqueue(camera) for camera in cameras]
        >>> pending[0].result().image.shape == (cameras[0].height, cameras[0].width, 3)
        True
    """

    def __init__(self, draw: Callable[[], RenderResult]) -> None:
        self._draw: Callable[[], RenderResult] | None = draw
        self._result: RenderResult | None = None
        self._error: SplatreeError | None = None
        self._lock = threading.Lock()

    def wait(self) -> None:
        """Return when the view is drawn, or cannot be."""
        with self._lock:
            if self._draw is None:
                return
            try:
                self._result = self._draw()
            except SplatreeError as error:
                self._error = error
            self._draw = None

    def result(self) -> RenderResult:
        """Wait for the picture; the same object at each call.

        Raises:
            SplatreeError: what `Session.draw` would have raised.
        """
        self.wait()
        if self._error is not None:
            raise self._error
        assert self._result is not None
        return self._result
