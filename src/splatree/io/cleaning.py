"""Clean a scene from files to a file, in chunks wherever that can be.

The leaves are gone through two times: first for three columns of theirs, in which the middle, the radius and the pieces of the
scene are found (`splatree.edit.clean.survey`), then to write what stays. The file is that of `clean` and `write`, byte for byte.

A tree that stays one goes in runs of its rows (io/tree_runs.py).

Memory: 20 bytes a Gaussian between the passes, and 12 bytes a row of a tree; in a file where there is no room.
"""

import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from splatree.edit.clean import ROWS_AT_ONCE, CleanOptions, Leaves, check_left, clean, survey
from splatree.errors import InputError
from splatree.io.chunks import Chunks
from splatree.io.inputs import find_inputs
from splatree.io.joined import joined
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.memory import Scratch
from splatree.io.notes import notes_in, repairs_in, sentences_in
from splatree.io.objects import located
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.reading import read_one
from splatree.io.registry import detect, format_to_write
from splatree.io.runs import TreeRuns
from splatree.io.tree_runs import kept_runs, open_runs, write_runs
from splatree.io.writing import write, write_chunks
from splatree.progress import track
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.shapes import Array, Bool, Float32, Float64

__all__ = ["CleanedFile", "clean_file"]


@dataclass(frozen=True)
class CleanedFile:
    """What `clean_file` dropped.

    Example:
        >>> st.clean_file("city.ply", None, st.CleanOptions(max_size=1000.0)).dropped
        {'larger than max_size': 0}
    """

    path: Path | None
    """The file; None: nothing was written."""
    num_read: int
    """Number of Gaussians read, without merged nodes."""
    num_written: int
    """Number of Gaussians left, without merged nodes."""
    dropped: dict[str, int]
    """Number of Gaussians that each filter drops. One that several filters drop counts for each."""
    in_chunks: bool
    """Whether it went in chunks, with bounded memory."""
    lost: tuple[str, ...] = ()
    """What the file does not hold of the inputs, a sentence each."""
    repairs: dict[str, int] = field(default_factory=dict)
    """Number of values or rows that each rule of repair changed."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""


@checked
def clean_file(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str] | None,
    options: CleanOptions,
    *,
    cameras: Float64[Array, "v 3"] | None = None,
    reading: ReadOptions | None = None,
    max_memory: str | None = None,
    force: bool = False,
) -> CleanedFile:
    """Drop what does not belong to a scene, from files to a file, which is that of `clean` and `write`, byte for byte.

    Where both formats allow it, rows go through in chunks, so that files may be larger than memory. So do the rows of one tree, a
    folder of parts or an exact ``.splatree``, which is written as a ``.splatree`` with its levels. All else needs the scene in
    memory.

    Args:
        inputs: one path or several, which are read as one scene, as `read` reads them.
        output: the new file; None: nothing is written, only counted.
        options: the filters.
        cameras: centres of the cameras, world units, for ``max_distance``.
        reading: how the inputs are read; None: the defaults.
        max_memory: what may be taken, such as 4G, where rows go through in chunks; None: half of the free memory.
        force: replace the file if it exists.

    Returns:
        What each filter dropped.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: an input is missing or of no known format, nothing would be left, or ``max_memory`` is given where the scene
            has to be in memory.
        OutputError: the output exists, or could not be written; an old file is then whole.

    Example:
        >>> done = st.clean_file("city.ply", "clean.ply", st.CleanOptions(floaters=True), force=True)
        >>> done.num_read - done.num_written == done.dropped["floaters"]
        True
    """
    reading, target = reading or ReadOptions(), None if output is None else located(output)
    writing = WriteOptions(max_memory=max_memory)
    with local_inputs(inputs) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        parts, tree, chosen = None, None, None if target is None else format_to_write(target)
        if chosen is not None and chosen.name == "splatree" and len(found.paths) == 1 and not reading.repair:
            tree = open_runs(found.paths[0])
        if tree is not None or chosen is None or chosen.write_chunks is not None:
            leaves = tree is not None or chosen is None or chosen.holds.levels != "tree"
            parts = opened_chunks(found.paths, reading, leaves=leaves)
        if parts is not None:
            chunks = joined_chunks(parts, found.paths)
            done = _in_chunks(chunks, parts, tree, target, options, cameras, writing, force)
        elif max_memory is not None:
            raise InputError(
                f"max_memory: found {max_memory}, but this needs the whole scene in memory: the output keeps levels, or an input "
                "is not read in chunks (see `splatree formats`)"
            )
        else:
            done = _in_memory(found.paths, target, options, cameras, reading, force)
    return replace(done, notes=(*found.notes, *done.notes))


def _in_memory(
    paths: Sequence[Path],
    target: Path | None,
    options: CleanOptions,
    cameras: Array | None,
    reading: ReadOptions,
    force: bool,
) -> CleanedFile:
    scene = joined(read_one(path, reading) for path in paths)
    cleaned, metadata = clean(scene, options, cameras=cameras), scene.source.metadata
    lost = () if target is None else write(cleaned.scene, target, force=force)
    return CleanedFile(
        path=target,
        num_read=scene.tree.num_leaves,
        num_written=scene.tree.num_leaves - cleaned.num_dropped,
        dropped=cleaned.dropped,
        in_chunks=False,
        lost=() if target is None else tuple(dict.fromkeys((*sentences_in(metadata, "lost"), *lost))),
        repairs=repairs_in(metadata),
        notes=notes_in(metadata, scene.source.origin),
    )


def _in_chunks(
    chunks: Chunks,
    parts: Sequence[Chunks],
    tree: TreeRuns | None,
    target: Path | None,
    options: CleanOptions,
    cameras: Array | None,
    writing: WriteOptions,
    force: bool,
) -> CleanedFile:
    scratch = _scratch(target, writing.max_memory)
    columns = _columns_of(chunks, scratch)

    def begin() -> Iterator[Leaves]:
        for first in range(0, len(columns), ROWS_AT_ONCE):
            part = columns[first : first + ROWS_AT_ONCE]
            yield Leaves(part[:, :3].copy(), part[:, 3].copy(), part[:, 4].copy())

    found, counts, num_dropped = survey(begin, len(chunks), options, cameras), Counter[str](), 0
    for leaves in begin():
        more, dropped = found.decide(leaves)
        counts.update(more)
        num_dropped += int(dropped.sum())
    check_left(counts, num_dropped, len(chunks))
    del columns  # before the writer takes memory of its own

    def goes(g: Gaussians) -> Bool[Array, "n"]:
        return found.decide(Leaves.of(g))[1]

    def left() -> Iterator[Gaussians]:
        return (g.take(~dropped) if (dropped := goes(g)).any() else g for g in chunks)

    cleaned, lost = replace(chunks, num_gaussians=len(chunks) - num_dropped, make=left), list[str]()
    if tree is not None and target is not None:
        write_runs(kept_runs(tree, goes, scratch), target, force=force)
    elif target is not None:
        lost = [*sentences_in(chunks.metadata, "lost"), *write_chunks(cleaned, target, force=force, options=writing)]
    repairs: Counter[str] = Counter(repairs_in(chunks.metadata))
    for part in parts:
        repairs.update(part.repairs)
    return CleanedFile(
        path=target,
        num_read=len(chunks),
        num_written=len(cleaned),
        dropped=dict(counts),
        in_chunks=True,
        lost=tuple(dict.fromkeys(lost)),
        repairs=dict(repairs),
        notes=notes_in(chunks.metadata, chunks.origin),
    )


def _scratch(target: Path | None, max_memory: str | None) -> Scratch:
    """Room beside the output; of a folder of SOG that is still to be made, beside the folder."""
    if target is None:
        return Scratch.beside(Path(tempfile.gettempdir()) / "nothing", max_memory)
    return Scratch.beside(target if target.parent.is_dir() else target.parent, max_memory)


def _columns_of(chunks: Chunks, scratch: Scratch) -> Float32[Array, "n 5"]:
    """What filters look at, of all rows: the means, the logarithms of the longest standard deviations, the logits."""
    columns, first = scratch.zeros((len(chunks), 5), np.float32), 0
    for g in track(chunks, "look at the scene"):
        leaves = Leaves.of(g)
        columns[first : first + len(g), :3] = leaves.means
        columns[first : first + len(g), 3] = leaves.sizes
        columns[first : first + len(g), 4] = leaves.logit_opacities
        first += len(g)
    return columns
