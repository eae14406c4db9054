"""Views that are asked for ahead: a picture is waited for when it is needed, and a session works at one call at a time."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from weakref import WeakSet

from splatree.errors import InputError, SplatreeError
from splatree.scene.frame import RenderResult

__all__ = ["Pending", "Turns"]


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


class Turns:
    """The calls of a session, one at a time from any thread, and the views that were asked for ahead."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._worker: ThreadPoolExecutor | None = None
        self._pending: WeakSet[Pending] = WeakSet()
        self._is_open = True

    @contextmanager
    def working(self) -> Iterator[None]:
        """One call of a session that is open.

        Raises:
            InputError: it is closed.
        """
        with self._lock:
            if not self._is_open:
                raise InputError("session: found it closed, wanted it open; open another with open_session")
            yield

    def waiting_for(self, work: Callable[[], RenderResult]) -> Callable[[], RenderResult]:
        """What waits for a device that is at work already, when no other call is."""

        def in_turn() -> RenderResult:
            with self._lock:
                return work()

        return in_turn

    def begun(self, work: Callable[[], RenderResult]) -> Callable[[], RenderResult]:
        """Let a thread do the work when its turn comes, and return what waits for it."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, "splatree-session")
        return self._worker.submit(self.waiting_for(work)).result

    def pending(self, drawn: Callable[[], RenderResult]) -> Pending:
        """A view that was asked for; `wait` waits for it."""
        pending = Pending(drawn)
        self._pending.add(pending)
        return pending

    def wait(self) -> None:
        """Return when all views that were asked for are drawn."""
        for pending in list(self._pending):
            pending.wait()

    def close(self) -> None:
        """Refuse further calls, and return when all views that were asked for are drawn."""
        with self._lock:
            self._is_open = False
        self.wait()
        if self._worker is not None:
            self._worker.shutdown()
