"""The system's Chromium without a screen, driven over its debugging protocol; a software GPU draws WebGL2."""

import base64
import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--ignore-gpu-blocklist",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--mute-audio",
    "--no-first-run",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
    "--disable-background-timer-throttling",
    "--remote-debugging-port=0",
)


def find_chromium() -> str | None:
    """The program, if it is installed."""
    return os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


class Page:
    """A tab."""

    def __init__(self, address: str) -> None:
        self._stack = contextlib.ExitStack()
        self._socket = self._stack.enter_context(connect(address, max_size=None, open_timeout=60))
        self._id = 0
        self.errors: list[str] = []
        """What the page complained about: exceptions, errors of the console, and answers of 400 and more."""
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)

    def call(self, method: str, timeout: float = 120, **params: Any) -> dict[str, Any]:
        """One command of the protocol and its result."""
        self._id += 1
        self._socket.send(json.dumps({"id": self._id, "method": method, "params": params}))
        deadline = time.monotonic() + timeout
        while True:
            message = json.loads(self._socket.recv(timeout=max(0.1, deadline - time.monotonic())))
            if message.get("id") == self._id:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.errors.append(str([a.get("value", a.get("description")) for a in params["args"]]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        elif method == "Network.responseReceived" and params["response"]["status"] >= 400:
            self.errors.append(f"{params['response']['status']} {params['response']['url']}")

    def open(self, url: str, *, size: tuple[int, int] = (640, 360), scale: float = 1, is_phone: bool = False) -> None:
        """Go to an address in a window of a size in px."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=scale,
            mobile=is_phone,
        )
        if is_phone:
            self.call("Emulation.setTouchEmulationEnabled", enabled=True)
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str, timeout: float = 120) -> Any:
        """The value of an expression in the page; of a promise when it is kept."""
        found = self.call(
            "Runtime.evaluate", timeout=timeout, expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"].get("exception", {}).get("description", str(found)))
        return found["result"].get("value")

    def wait_for(self, expression: str, timeout: float = 300) -> None:
        """Wait until an expression is true; an error says what the page complained about."""
        deadline = time.monotonic() + timeout
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{expression} is not true after {timeout} s; the page said {self.errors}")
            time.sleep(0.1)

    def screenshot(self, path: Path | None = None) -> np.ndarray:
        """The window as (h w 3), 0 to 1."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float64) / 255

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """An event of the mouse: mouseMoved, mousePressed, mouseReleased, mouseWheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def touch(self, steps: Sequence[Sequence[tuple[float, float]]]) -> None:
        """Fingers put down at the first places, moved over the others and lifted."""
        for i, places in enumerate(steps):
            points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
            self.call("Input.dispatchTouchEvent", type="touchMove" if i else "touchStart", touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def close(self) -> None:
        """Close the tab; a second time is harmless."""
        with self._stack, contextlib.suppress(ConnectionClosed, TimeoutError):
            self.call("Page.close", timeout=20)


@contextlib.contextmanager
def chromium(folder: Path, *more: str) -> Iterator["Browser"]:
    """A browser with its profile in a folder; ended with all that it started."""
    program = find_chromium()
    assert program is not None
    process = subprocess.Popen(
        [program, *FLAGS, *more, f"--user-data-dir={folder}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        port_file = folder / "DevToolsActivePort"
        deadline = time.monotonic() + 120
        while not (port_file.exists() and port_file.read_text().strip()):
            if time.monotonic() > deadline or process.poll() is not None:
                raise RuntimeError(f"{program} did not start ({process.poll()})")
            time.sleep(0.1)
        port, path = port_file.read_text().split()[:2]
        yield Browser(int(port), path)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


class Browser:
    """A running browser."""

    def __init__(self, port: int, path: str) -> None:
        self._port, self._path = port, path
        self._pages: list[Page] = []

    def close_pages(self) -> None:
        """Close all tabs: an open one keeps its connection and draws on."""
        while self._pages:
            self._pages.pop().close()

    def new_page(self) -> Page:
        """A new page."""
        with connect(f"ws://127.0.0.1:{self._port}{self._path}", open_timeout=60) as socket:
            # A window of its own: a tab behind another one draws nothing.
            params = {"url": "about:blank", "newWindow": True}
            socket.send(json.dumps({"id": 1, "method": "Target.createTarget", "params": params}))
            while True:
                message = json.loads(socket.recv(timeout=60))
                if message.get("id") == 1:
                    target = message["result"]["targetId"]
                    self._pages.append(Page(f"ws://127.0.0.1:{self._port}/devtools/page/{target}"))
                    return self._pages[-1]
