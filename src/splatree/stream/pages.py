"""Pages that open a stream in the viewers of others, which the browser loads from npm packages."""

from html import escape
from importlib.resources import files
from typing import Final
from urllib.parse import quote

__all__ = ["PACKAGES", "VIEWERS", "index_page", "viewer_page"]

PACKAGES: Final = {"playcanvas": "2.23.3", "three": "0.180.0", "@sparkjsdev/spark": "2.2.0", "cesium": "1.145.0"}
"""npm packages and the versions that the pages were tested with."""

VIEWERS: Final = {"lod-meta.json": "playcanvas", ".rad": "spark", "tileset.json": "cesium"}
"""Which viewer opens a manifest or a file that ends so."""

_NAMES: Final = {"playcanvas": "PlayCanvas", "spark": "Spark", "cesium": "CesiumJS"}


def viewer_page(viewer: str, base: str, *, has_versions: bool) -> str | None:
    """The page of a viewer whose packages lie at ``base``, with their versions in the address or not; None if there is none."""
    if viewer not in VIEWERS.values():
        return None
    text = (files("splatree.stream") / "page" / f"{viewer}.html").read_text("utf-8")
    for name, version in PACKAGES.items():
        text = text.replace(f"{{{{{name}}}}}", f"{base}/{name}{f'@{version}' if has_versions else ''}")
    return text


def index_page(title: str, streams: tuple[str, ...]) -> str:
    """A page that lists streams, with a link to a viewer for each."""
    items = []
    for stream in streams:
        viewer = next(viewer for end, viewer in VIEWERS.items() if stream.endswith(end))
        link = f"open/{viewer}?stream={quote(stream)}"
        items.append(
            f'<li><a href="{escape(link)}">Open in {_NAMES[viewer]}</a> <a class="file" href="{escape(quote(stream))}">'
            f"{escape(stream)}</a></li>"
        )
    text = (files("splatree.stream") / "page" / "index.html").read_text("utf-8")
    return text.replace("{{title}}", escape(title)).replace("{{streams}}", "\n".join(items))
