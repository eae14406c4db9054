"""What describes a scene without holding all of it: every row without its harmonics, and a sample with them.

Harmonics are three quarters of a scene at degree 3. A file that can be read in chunks is gone through once, and they are left
behind: 56 bytes a Gaussian stay in memory, of 248 in a .ply. Other formats are read whole.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from splatree.io.inputs import find_inputs
from splatree.io.joined import joined_source
from splatree.io.joined_chunks import joined_chunks, opened_chunks
from splatree.io.local import local_inputs
from splatree.io.notes import with_notes
from splatree.io.options import ReadOptions
from splatree.io.reading import read
from splatree.io.registry import detect
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source

__all__ = ["Outline", "outline_of", "read_outline"]

SAMPLE: Final = 60_000
"""Rows with their harmonics, at least, of a scene that has so many: as many as framing looks at."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A scene, possibly without its harmonics."""

    scene: Scene
    """Every row; of degree 0 if the file went through in chunks."""
    sample: Scene
    """Rows with all their columns, spread evenly over the file; the scene itself where it was read whole."""
    in_chunks: bool
    """Whether the file went through in chunks."""

    @property
    def nbytes(self) -> int:
        """Memory of all columns of the scene, harmonics included, bytes."""
        missing: int = self.sample.gaussians.sh.shape[1] - self.scene.gaussians.sh.shape[1]
        return self.scene.gaussians.nbytes + 12 * missing * len(self.scene)


def outline_of(scene: Scene) -> Outline:
    """The outline of a scene in memory: the scene itself."""
    return Outline(scene, scene, in_chunks=False)


def read_outline(paths: Sequence[Path], options: ReadOptions) -> Outline:
    """Read what describes a scene, in chunks wherever its formats allow that.

    Args:
        paths: files or folders, which are one scene, as `read` takes them.
        options: how they are read.

    Raises:
        FormatError: a file does not hold what it promises.
        InputError: nothing is there, it is of no known format, or the inputs cannot be joined.
    """
    with local_inputs(paths) as local:
        found = find_inputs(local.paths, lambda path: detect(path) is not None)
        outline = _in_chunks(found.paths, options) if options.level is None else None
        if outline is None:
            outline = outline_of(
                read(
                    found.paths,
                    level=options.level,
                    repair=options.repair,
                    axes=options.axes,
                    ignore_properties=options.ignore_properties,
                )
            )
    source = outline.scene.source
    source = with_notes(replace(source, paths=tuple(map(local.named, source.paths))), found.notes)
    return replace(outline, scene=replace(outline.scene, source=source), sample=replace(outline.sample, source=source))


def _in_chunks(paths: Sequence[Path], options: ReadOptions) -> Outline | None:
    parts = opened_chunks(paths, options)
    if parts is None:
        return None
    chunks = joined_chunks(parts, paths)
    plain = Gaussians(*(np.empty((len(chunks), *c.shape[1:]), c.dtype) for c in vars(Gaussians.empty()).values()))
    samples, step, row = [Gaussians.empty(chunks.sh_degree)], -(-len(chunks) // SAMPLE) or 1, 0
    with task("read", len(chunks)) as advance:
        for chunk in chunks:
            for name, column in vars(chunk.with_sh_degree(0)).items():
                getattr(plain, name)[row : row + len(chunk)] = column
            samples.append(chunk.take(np.arange(-row % step, len(chunk), step)))
            row += len(chunk)
            advance(len(chunk))
    named = [Source((str(path),), _format_name(path), part.metadata) for path, part in zip(paths, parts, strict=True)]
    joined = joined_source(named)
    source = Source(joined.paths, joined.format, _with_repairs(chunks.metadata, [part.repairs for part in parts]))
    source = replace(source, origin=chunks.origin)
    scene, sample = (Scene.flat(g, mode=chunks.mode, source=source) for g in (plain, Gaussians.concatenate(samples)))
    return Outline(scene, sample, in_chunks=True)


def _format_name(path: Path) -> str:
    found = detect(path)
    return "" if found is None else found.name


def _with_repairs(metadata: Mapping[str, str], repairs: Sequence[dict[str, int]]) -> dict[str, str]:
    """The metadata with what the pass over the rows had to repair."""
    counts: Counter[str] = Counter()
    for part in repairs:
        counts.update(part)
    return {**metadata, "repairs": json.dumps(counts)} if counts else dict(metadata)
