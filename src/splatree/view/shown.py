"""What the viewer asks of a scene that it shows, in memory or on disk.

Rows come in parts: all at once from memory, page by page from a store. Each part is columns that hold more than is asked for, and
the places of the rows in them; so nothing is copied.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatree.errors import InputError
from splatree.outofcore.store import Store
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array, Float32, Float64, Int32, UInt8
from splatree.view.boxes import BoxKind, boxes_of

__all__ = ["InMemory", "OnDisk", "Part", "Shown", "shown_of"]


@dataclass(frozen=True, eq=False)
class Part:
    """Some rows of a scene, where they lie."""

    of_rows: Array | slice
    """Which of the rows that were asked for they are."""
    gaussians: Gaussians
    """Columns that hold them."""
    tree: GaussianTree
    """Which of these columns' rows are leaves, and how merged ones follow the pixel; depths may count from another row."""
    places: Int32[Array, "w"]
    """Their rows in the columns."""


class Shown(ABC):
    """A scene on show."""

    scene: Scene
    """How it is drawn; its rows too, where they are in memory."""
    num_nodes: int
    """Nodes of the tree."""
    num_leaves: int
    """Leaves of the tree."""
    num_levels: int
    """Largest depth + 1."""
    sample: Scene
    """What says where the scene lies: the scene, or some of its leaves."""
    follows: bool
    """Whether merged nodes follow the pixel that they are drawn at."""

    @abstractmethod
    def parts(self, rows: Int32[Array, "v"]) -> Iterator[Part]:
        """The rows, ascending, in parts."""

    @abstractmethod
    def depths(self, rows: Int32[Array, "v"]) -> UInt8[Array, "v"]:
        """Their depth in the tree."""

    @abstractmethod
    def boxes(self, kind: BoxKind, rows: Int32[Array, "v"], most: int) -> Float64[Array, "b 2 3"]:
        """As `boxes_of`."""

    def means(self, rows: Int32[Array, "v"]) -> Float32[Array, "v 3"]:
        """Their means, world units."""
        found = np.empty((len(rows), 3), np.float32)
        for part in self.parts(rows):
            found[part.of_rows] = part.gaussians.means[part.places]
        return found


class InMemory(Shown):
    """A scene whose rows are all there."""

    def __init__(self, scene: Scene) -> None:
        self.scene = self.sample = scene
        self.num_nodes, self.num_leaves, self.num_levels = len(scene), scene.tree.num_leaves, scene.tree.num_levels
        self.follows = scene.tree.curves is not None

    def parts(self, rows: Int32[Array, "v"]) -> Iterator[Part]:
        """One part."""
        yield Part(slice(None), self.scene.gaussians, self.scene.tree, rows)

    def depths(self, rows: Int32[Array, "v"]) -> UInt8[Array, "v"]:
        """Their depth in the tree."""
        return self.scene.tree.depth[rows]

    def boxes(self, kind: BoxKind, rows: Int32[Array, "v"], most: int) -> Float64[Array, "b 2 3"]:
        """Boxes that hold the rows."""
        return boxes_of(self.scene, kind, rows, most)


class OnDisk(Shown):
    """A store."""

    def __init__(self, store: Store) -> None:
        self.store, self.scene, self.sample = store, store.scene, store.sample()
        index = store.index
        self.num_nodes, self.num_leaves, self.num_levels = index.num_rows, index.num_leaves, index.num_levels
        self.follows = store.follows

    def parts(self, rows: Int32[Array, "v"]) -> Iterator[Part]:
        """A part a page."""
        cut = self.store.find(rows)
        for number, of_page in cut.by_page():
            places = cut.places[of_page]
            page = self.store.page_to_draw(number, places)
            yield Part(of_page, page.gaussians, page.tree, places)

    def depths(self, rows: Int32[Array, "v"]) -> UInt8[Array, "v"]:
        """Their depth in the tree."""
        return self.store.depths(self.store.find(rows))

    def boxes(self, kind: BoxKind, rows: Int32[Array, "v"], most: int) -> Float64[Array, "b 2 3"]:
        """Boxes of the pages, in place of blocks; a store has no others."""
        if kind != "blocks":
            return np.zeros((0, 2, 3))
        found = np.unique(self.store.find(rows).pages)
        found, table = found[:: max(1, -(-len(found) // most))], self.store.index.table
        return np.stack([table.lower[found], table.upper[found]], axis=1).astype(np.float64)


def shown_of(scene: Scene | Store) -> Shown:
    """A scene or a store, to be shown.

    Raises:
        InputError: it is empty.
    """
    if len(scene) == 0:
        raise InputError("view: found no Gaussians, wanted at least one to show")
    return OnDisk(scene) if isinstance(scene, Store) else InMemory(scene)
