"""Write a ``.splatree`` part by part: memory holds one part at a time.

The columns of the file follow each other, so where each of them lies depends on the number of rows. It is said beforehand
(`SceneHead`), and each part is written into its place in every column.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import BinaryIO

import numpy as np

from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.formats.splatree.container import SPARE_BYTES, Column, header_bytes, placed
from splatree.io.formats.splatree.fields import (
    STORED_AS,
    cluster_types,
    column_types,
    columns_of,
    source_text,
    values_of,
)
from splatree.io.formats.splatree.head import SceneHead
from splatree.io.formats.splatree.rows import SceneRows
from splatree.io.pages.index_file import append_index, wants_index
from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.scene.clusters import ClusterIndex
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene
from splatree.shapes import Array

__all__ = ["SceneWriter", "create_scene", "write_plain"]


class SceneWriter:
    """A ``.splatree`` that is being written, part by part; `create_scene` makes one.

    Example:
        >>> with st.create_scene("copy.splatree", st.SceneHead.of(scene)) as writer:
        ...     writer.append(scene)
        >>> len(st.read("copy.splatree")) == len(scene)
        True
    """

    def __init__(self, file: BinaryIO, head: SceneHead, num_clusters: int = 0, *, spare: int = 0) -> None:
        self.head = head
        """What the file will hold."""
        self.num_written = 0
        """Rows written so far."""
        self.num_clusters = num_clusters
        """Clusters that are still to be written."""
        self._file = file
        k = (head.sh_degree + 1) ** 2
        roots = {} if head.roots is None else dict(columns_of(head.roots, "tree.roots."))
        own = column_types(head.num_rows, k, has_ids=head.has_ids, has_curves=head.has_curves)
        ids = {"ids": own.pop("ids")} if head.has_ids else {}
        kept = {name: (column.dtype, column.shape) for name, column in roots.items()}
        self._places = placed(own | kept | ids | (cluster_types(num_clusters) if num_clusters else {}))
        text = header_bytes(_values(head), self._places, spare=spare)
        self._start = len(text)
        file.write(text)
        file.truncate(self._start + sum(place.num_bytes for place in self._places.values()))
        for name, column in roots.items():
            self._write(name, 0, column)

    def append(self, part: Scene | SceneRows) -> None:
        """Write the rows of a part after those before it.

        Args:
            part: a scene, whose roots stand beside those before it; or rows of a stored scene. Runs of rows that follow each
                other in a stored scene may be appended one after the other, whatever subtrees they cut.

        Raises:
            InputError: there are more rows than were announced, or harmonics of a higher degree.
            FormatError: a value cannot be used.
        """
        rows = SceneRows.of(part) if isinstance(part, Scene) else part
        begin, end = self.num_written, self.num_written + len(rows)
        if end > self.head.num_rows:
            raise InputError(
                f"part: found {end} rows with those before it, wanted at most the {self.head.num_rows} announced"
            )
        if rows.gaussians.sh_degree > self.head.sh_degree:
            raise InputError(
                f"part: found harmonics of degree {rows.gaussians.sh_degree}, wanted at most the degree {self.head.sh_degree} "
                "announced"
            )
        refuse_unusable(rows.gaussians, "part to write", first_row=begin)
        gaussians = rows.gaussians.with_sh_degree(self.head.sh_degree)
        for f in fields(Gaussians):
            self._write(f"gaussians.{f.name}", begin, getattr(gaussians, f.name))
        self._write("tree.subtree_end", begin, rows.subtree_end + np.int32(begin - rows.begin))
        self._write("tree.depth", begin, rows.depth)
        self._write("tree.extents", begin, rows.extents)
        if self.head.has_curves:
            self._write("tree.curves", begin, np.zeros((len(rows), 4)) if rows.curves is None else rows.curves)
        if self.head.has_ids:
            self._write("ids", begin, np.arange(begin, end, dtype=np.uint32) if rows.ids is None else rows.ids)
        self.num_written = end

    def append_clusters(self, clusters: ClusterIndex) -> None:
        """Write the clusters of the rows, which were announced by their number.

        Raises:
            InputError: there are more or fewer than announced, or they are clusters of more or fewer rows.
        """
        if len(clusters) != self.num_clusters or clusters.num_rows != self.head.num_rows:
            raise InputError(
                f"clusters: found {len(clusters)} of {clusters.num_rows} rows, wanted the {self.num_clusters} announced of "
                f"{self.head.num_rows}"
            )
        for name, column in columns_of(clusters, "clusters."):
            self._write(name, 0, column)
        self.num_clusters = 0

    def _write(self, name: str, begin: int, rows: Array) -> None:
        place: Column = self._places[name]
        self._file.seek(self._start + place.start + begin * place.bytes_per_row)
        self._file.write(np.ascontiguousarray(rows, place.dtype).reshape(-1).view(np.uint8).data)


@checked
@contextmanager
def create_scene(
    path: str | os.PathLike[str], head: SceneHead, *, num_clusters: int = 0, force: bool = False, pages: bool = True
) -> Iterator[SceneWriter]:
    """Write a ``.splatree`` part by part: whole or not at all.

    Args:
        path: the new file.
        head: how many rows there will be, and how they are drawn.
        num_clusters: how many clusters of rows there will be, which `append_clusters` takes when they are known.
        force: replace the file if it exists.
        pages: whether a file of 100,000 rows and more with levels gets an index, so that it is opened at once to be drawn page by
            page. Making it takes about a microsecond a row.

    Yields:
        A writer whose `append` takes the parts. The file takes its place when the block ends.

    Raises:
        InputError: fewer or more rows were appended than announced, or no clusters where they were announced.
        FormatError: the rows are no tree, as the index shows.
        OutputError: the file exists, or could not be written; an old file is then whole.

    Example:
        >>> import splatree as st
        >>> scene = st.Scene.flat(st.Gaussians.empty())
        >>> with st.create_scene("empty.splatree", st.SceneHead.of(scene), force=True) as writer:
        ...     writer.append(scene)
    """
    is_indexed = pages and wants_index(head)
    with replacing(path, force=force) as temporary:
        with temporary.open("wb") as file:
            writer = SceneWriter(file, head, num_clusters, spare=SPARE_BYTES * is_indexed)
            yield writer
        if writer.num_written != head.num_rows:
            raise InputError(f"{path}: found {writer.num_written} rows appended, wanted the {head.num_rows} announced")
        if writer.num_clusters:
            raise InputError(f"{path}: found no clusters appended, wanted the {writer.num_clusters} announced")
        if is_indexed:
            append_index(temporary)


def write_plain(scene: Scene, path: Path) -> None:
    """Write a scene as a piece of a larger one, which has an index of its own; an older file is replaced.

    Raises:
        OutputError: it could not be written.
    """
    with create_scene(path, SceneHead.of(scene), force=True, pages=False) as writer:
        writer.append(scene)


def _values(head: SceneHead) -> dict[str, str]:
    """The strings of the header, as `format.write` has them."""
    values = {} if head.record is None else {"tree.record": head.record.to_json()}
    if head.roots is not None:
        values |= dict(values_of(head.roots, "tree.roots."))
    values |= {"mode": json.dumps(head.mode), "threshold": json.dumps(head.threshold)}
    if head.tile_rule is not None:
        values[STORED_AS["tile_rule"]] = json.dumps(head.tile_rule)
    return {**values, "source": source_text(head.source)}
