"""From files to a file of another format, edited on the way, in chunks wherever that can be: then memory is a few chunks.

A conversion goes in chunks if every input is of a format that is read so, the output of one that is written so, and nothing is
asked that needs the whole scene, as a level does. A tree that stays one, or is cut, goes in runs of its rows (io/tree_runs.py).
The file has the same bytes either way: a format that is written in chunks has no other writer, and edits work row by row. Where
rows may be dropped, the inputs are read twice, first to count what is left.
"""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from splatree.edit.edit import edit, edit_rows, kept_rows, merged_lost, move_from_options, with_loss
from splatree.edit.options import EditOptions
from splatree.errors import InputError
from splatree.io.check import refuse_unusable
from splatree.io.chunks import Chunks
from splatree.io.cut import cut_at
from splatree.io.inputs import find_inputs
from splatree.io.joined import joined
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.memory import Scratch
from splatree.io.notes import notes_in, repairs_in, sentences_in
from splatree.io.objects import located
from splatree.io.options import ReadOptions, WriteOptions
from splatree.io.reading import needed_bytes, read_one
from splatree.io.registry import detect, format_to_write
from splatree.io.replacing import check_target
from splatree.io.runs import TreeRuns
from splatree.io.sorting import along_curve
from splatree.io.tree_runs import cut_chunks, kept_runs, moved_runs, open_runs, write_runs
from splatree.io.writing import write, write_chunks
from splatree.progress import track
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import given
from splatree.scene.literals import check_literals
from splatree.scene.modes import check_mode_of_levels, in_mode
from splatree.scene.names import Mode
from splatree.scene.origin import Origin

__all__ = ["ConvertOptions", "Converted", "convert"]


@dataclass(frozen=True)
class ConvertOptions:
    """How a conversion reads, edits and writes.

    Example:
        >>> options = st.ConvertOptions(edit=st.EditOptions(sh_degree=0))
        >>> st.convert("city.ply", "plain.spz", options, force=True).lost[0]
        'precision: spz rounds values to steps of its own'
    """

    read: ReadOptions = field(default_factory=ReadOptions)
    """How the inputs are read."""
    edit: EditOptions = field(default_factory=EditOptions)
    """Edits between reading and writing."""
    write: WriteOptions = field(default_factory=WriteOptions)
    """How the output is written."""
    depth: int | None = None
    """Write one cut of the tree to a format without levels: the nodes at this depth (0: the roots) and the leaves above it; None:
    the leaves."""

    mode: Mode | None = None
    """How the scene was trained and is drawn, where the file does not say it; None: as the file says, else `classic`. Levels of
    detail keep the mode that they were made for."""

    def __post_init__(self) -> None:
        check_literals(self)
        if self.depth is not None and self.depth < 0:
            raise InputError(f"depth: found {self.depth}, wanted 0 (the roots) or more")


@dataclass(frozen=True)
class Converted:
    """What a conversion did.

    Example:
        >>> done = st.convert("city.ply", "city.sog", force=True)
        >>> done.num_read == done.num_written
        True
    """

    num_read: int
    """Number of Gaussians read, without merged nodes."""
    num_written: int
    """Number of Gaussians left after the edits, without merged nodes; with a depth, number of nodes of the cut."""
    lost: tuple[str, ...]
    """What the file does not hold of the inputs, a sentence each."""
    repairs: dict[str, int]
    """Number of values or rows that each rule of repair changed."""
    in_chunks: bool
    """Whether the conversion went in chunks, with bounded memory."""
    notes: tuple[str, ...] = ()
    """What reading did that the user should know, a sentence each."""


@checked
def convert(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: ConvertOptions | None = None,
    *,
    force: bool = False,
) -> Converted:
    """Convert a scene to the format that the suffix of the output names.

    Where both formats allow it, rows go through in chunks, so that files may be larger than memory.

    Args:
        inputs: one path or several, which are read as one scene, as `read` reads them.
        output: the new file.
        options: how to read, edit and write; None: the defaults.
        force: replace the file if it exists.

    Returns:
        Counts, and what the file does not hold of the inputs.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: an input is missing or of no known format, or an option does not suit the formats.
        OutputError: the output exists, or could not be written; an old file is then whole.

    Example:
        >>> st.convert("city.ply", "city.splat", force=True).num_written
        253
    """
    options, target = given(options, ConvertOptions, "convert: options"), located(output)
    with local_inputs(inputs) as local:
        found = find_inputs(local.paths, lambda p: detect(p) is not None)
        done = _converted_from(found.paths, target, options, force)
    return replace(done, notes=(*found.notes, *done.notes))


def _converted_from(found: Sequence[Path], target: Path, options: ConvertOptions, force: bool) -> Converted:
    chosen = format_to_write(target)
    by_runs = options.read.level is None and not options.write.compact
    by_rows = options.depth is None and not options.write.compact
    keeps_rows = options.edit.order == "kept" and not options.read.repair
    cuts = options.depth is not None and chosen.holds.levels != "tree" and chosen.write_chunks is not None
    takes_runs = cuts or (chosen.name == "splatree" and options.depth is None)
    if by_runs and keeps_rows and takes_runs and len(found) == 1 and (tree := open_runs(found[0])):
        return _in_runs(tree, target, options, force)
    leaves = chosen.holds.levels != "tree"
    if chosen.write_chunks is not None and by_rows and (parts := opened_chunks(found, options.read, leaves=leaves)):
        return _in_chunks(found, parts, target, options, force)

    if options.write.max_memory is not None:
        needs = [(path, needed) for path in found if (needed := needed_bytes(path)) is not None]
        takes = "".join(f"; reading {path} takes about {needed // 10**6} MB" for path, needed in needs[:1])
        raise InputError(
            f"max_memory: found {options.write.max_memory} for {target}, but this conversion holds the whole scene: a depth of "
            "several inputs is asked for, the output is compact or keeps levels, or an input is not read in chunks "
            f"(see `splatree formats`){takes}; wanted --max-memory for conversions in chunks alone"
        )
    scenes = (read_one(path, options.read) for path in found)
    if options.mode is not None:
        takes_leaves = leaves and options.depth is None
        scenes = (
            replace(scene, mode=options.mode) if takes_leaves else in_mode(scene, options.mode) for scene in scenes
        )
    scene = joined(scenes)
    num_read = scene.tree.num_leaves
    scene = edit(scene, options.edit)
    if options.edit != EditOptions():
        refuse_unusable(scene.gaussians, "the scene after the edits")
    if options.depth is not None:
        scene = cut_at(scene, options.depth)
    lost = write(scene, target, force=force, options=options.write)
    return _converted(num_read, scene.tree.num_leaves, scene.source.metadata, lost, scene.source.origin)


def _in_runs(tree: TreeRuns, target: Path, options: ConvertOptions, force: bool) -> Converted:
    """A tree as one file, or a cut of it, edited on the way, in runs of rows."""
    check_mode_of_levels(options.mode, None if tree.head.record is None else tree.head.record.mode)
    source, scratch = tree.head.source, Scratch.beside(check_target(target), options.write.max_memory)
    move = move_from_options(options.edit, source.origin)
    kept = tree
    if options.edit.may_drop_rows:
        kept = kept_runs(tree, lambda g: ~kept_rows(g, move.similarity.moved(g), options.edit, move.origin), scratch)
        num_merged, num_left = len(tree) - tree.num_leaves, len(kept) - kept.num_leaves
        if num_left < num_merged:
            source = with_loss(source, merged_lost(num_merged - num_left, num_merged))
    edited = moved_runs(kept, move.similarity, min(options.edit.sh_degree, tree.head.sh_degree))
    source = replace(source, metadata=move.similarity.metadata(source.metadata), origin=move.origin)
    head = replace(edited.head, mode=options.mode or edited.head.mode, source=source)
    edited = replace(edited, head=head)
    lost: tuple[str, ...] = ()
    num_written = edited.num_leaves
    if options.depth is None:
        write_runs(edited, target, force=force)
    else:
        cut = cut_chunks(edited, options.depth)
        num_written = len(cut)
        lost = write_chunks(cut, target, force=force, options=options.write)
    converted = _converted(tree.num_leaves, num_written, source.metadata, lost, source.origin)
    return replace(converted, in_chunks=True)


def _in_chunks(
    paths: Sequence[Path], parts: Sequence[Chunks], target: Path, options: ConvertOptions, force: bool
) -> Converted:
    if options.mode is not None:
        parts = [replace(part, mode=options.mode) for part in parts]
    chunks = joined_chunks(parts, paths)
    edited = _edited_chunks(chunks, options.edit)
    with ExitStack() as stack:
        ordered = edited
        if options.edit.order == "morton":
            scratch = Scratch.beside(check_target(target), options.write.max_memory)
            ordered = stack.enter_context(along_curve(edited, scratch))
        lost = write_chunks(ordered, target, force=force, options=options.write)
    return _converted(len(chunks), len(edited), chunks.metadata, lost, edited.origin, parts)


def _converted(
    num_read: int,
    num_written: int,
    metadata: Mapping[str, str],
    lost: tuple[str, ...],
    origin: Origin,
    parts: Sequence[Chunks] = (),
) -> Converted:
    """``parts`` are the inputs, if they were read in chunks."""
    lost = (*sentences_in(metadata, "lost"), *lost)
    repairs: Counter[str] = Counter(repairs_in(metadata))
    for part in parts:
        repairs.update(part.repairs)
    notes = notes_in(metadata, origin)
    if num_read and not num_written:
        notes = (
            *notes,
            "nothing is left of the scene: no Gaussian passes all filters; `splatree info` has its numbers",
        )
    return Converted(num_read, num_written, lost, dict(repairs), bool(parts), notes)


def _edited_chunks(chunks: Chunks, options: EditOptions) -> Chunks:
    if replace(options, order="kept") == EditOptions():
        return chunks
    count, move = len(chunks), move_from_options(options, chunks.origin)
    if options.may_drop_rows:
        count = sum(len(edit_rows(chunk, options, move)) for chunk in track(chunks, "count what is left"))
    return replace(
        chunks,
        num_gaussians=count,
        sh_degree=min(chunks.sh_degree, options.sh_degree),
        make=lambda: (_usable(edit_rows(chunk, options, move)) for chunk in chunks),
        metadata=move.similarity.metadata(chunks.metadata),
        origin=move.origin,
    )


def _usable(edited: Gaussians) -> Gaussians:
    """Rows that were scaled or moved out of what can be read are not written."""
    refuse_unusable(edited, "the scene after the edits")
    return edited
