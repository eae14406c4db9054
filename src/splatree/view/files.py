"""The files of the page, and what a browser may do with them.

The page loads nothing from anywhere else: its policy (Content-Security-Policy) forbids it.
"""

import json
import re
from importlib.resources import files
from typing import Any, Final

from splatree.view.options import ViewOptions

__all__ = ["index_of", "page_files", "policy"]

TYPES: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
"""Files that the page is made of."""

NOTEBOOKS: Final = ("http://localhost:*", "http://127.0.0.1:*", "vscode-webview:", "vscode-file:")
"""Pages that may hold the viewer in a frame: notebooks of this machine."""


def page_files() -> dict[str, tuple[bytes, str]]:
    """Contents and types of the page's files by name."""
    found = {}
    for entry in (files("splatree.view") / "page").iterdir():
        suffix = "." + entry.name.rpartition(".")[2]
        if suffix in TYPES:
            found[entry.name] = (entry.read_bytes(), TYPES[suffix])
    return found


def index_of(page: bytes, settings: dict[str, Any]) -> str:
    """The page with its settings in an attribute."""
    return page.decode().replace("{{settings}}", json.dumps(settings).replace("&", "&amp;").replace('"', "&quot;"))


def policy(options: ViewOptions, host: str) -> str:
    """What the page may load and do, as the header Content-Security-Policy; ``host`` is that of the request."""
    # Safari before 15.4 does not take a WebSocket to the own host for 'self'.
    sockets = f" ws://{host} wss://{host}" if re.fullmatch(r"[\w.\-\[\]:]+", host) else ""
    parts = {
        "default-src": "'none'",
        "script-src": "'self'",
        "worker-src": "'self'",
        "style-src": "'self'",
        "img-src": "'self' blob: data:",
        "media-src": "blob:",
        "connect-src": f"'self'{sockets}",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": " ".join(["'self'", *NOTEBOOKS, *options.allow_origin]),
    }
    return "; ".join(f"{name} {value}" for name, value in parts.items())
