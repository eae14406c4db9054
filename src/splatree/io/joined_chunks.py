"""Several files in chunks, as one scene: what `joined` does with scenes in memory.

Memory is one chunk of one file at a time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from splatree.errors import InputError
from splatree.io.budget import RowBudget
from splatree.io.chunks import Chunks
from splatree.io.joined import joined_source, relative_to
from splatree.io.notes import with_notes
from splatree.io.options import ReadOptions
from splatree.io.registry import detect, files_of
from splatree.scene.gaussians import Gaussians

__all__ = ["joined_chunks", "opened_chunks"]


def opened_chunks(paths: Sequence[Path], options: ReadOptions, *, leaves: bool = False) -> list[Chunks] | None:
    """All inputs in chunks; None if one of them cannot be read so, or has not the levels of which one is asked for.

    With ``leaves``, those of a scene with levels will do.
    """
    parts, budget = [], RowBudget(f"{paths[0]} and {len(paths) - 1} more")
    for path in paths:
        found = detect(path)
        chunks = None
        if found is not None and options.level is not None and found.holds.levels != "one of":
            return None
        if found is not None and (read := found.read_chunks or (found.read_leaves if leaves else None)) is not None:
            chunks = read(path, options)
        if chunks is None:
            return None
        if len(paths) > 1:
            for file in files_of(path):
                budget.add_file(file)
            budget.take(len(chunks))
        assert found is not None  # it has read the chunks
        parts.append(replace(chunks, paths=(str(path),), format=found.name))
    return parts


def joined_chunks(parts: Sequence[Chunks], paths: Sequence[Path]) -> Chunks:
    """All rows in order, as `joined` does with scenes."""
    first = parts[0]
    if len(parts) == 1:
        return first
    degree = max(part.sh_degree for part in parts)
    for part, path in zip(parts, paths, strict=True):
        for name in ("mode", "threshold"):
            if (found := getattr(part, name)) != (wanted := getattr(first, name)):
                raise InputError(
                    f"inputs differ in their {name}: {path} has {found}, those before it {wanted}; wanted scenes of one "
                    "training, convert them one by one: `splatree convert --mode` writes one in another mode"
                )

    def make() -> Iterator[Gaussians]:
        for part in parts:
            for chunk in part:
                yield relative_to(chunk.with_sh_degree(degree), part.origin, first.origin)

    source = joined_source([part.source for part in parts])
    source = with_notes(source, [f"{len(parts)} inputs were joined as one scene"])
    return Chunks(
        *(sum(map(len, parts)), degree, first.mode, make, source.metadata),
        origin=first.origin,
        paths=source.paths,
        format=source.format,
        threshold=first.threshold,
        num_merged=sum(part.num_merged for part in parts),
        num_clusters=sum(part.num_clusters for part in parts),
    )
