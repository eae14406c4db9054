"""Gaussians in chunks, to be gone through as often as a writer likes: a scene in memory or a file that is larger than it.

A format that can be written chunk by chunk has ``write_chunks`` in place of ``write``: then the same lines write a scene and a
stream, so both give the same bytes. One that can be read so has ``read_chunks`` beside ``read``. `splatree.io.convert` joins
the two; its memory is a few chunks.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from splatree.errors import InputError
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene

ROWS_PER_CHUNK = 1 << 14
"""4 MB at degree 3: small beside any scene and, with as much of a file's records, in the processor's last cache; large beside
what a call costs."""

Counts = dict[str, int]
"""How many values or rows each rule of repair touched."""


@dataclass(frozen=True, eq=False)
class Chunks:
    """Gaussians of one flat scene, a chunk at a time."""

    num_gaussians: int
    """Gaussians in all."""
    sh_degree: int
    """Degree of the harmonics of every chunk."""
    mode: Mode
    """How the scene is drawn."""
    make: Callable[[], Iterator[Gaussians]]
    """Start again from the first row; values have been checked, and a chunk is valid until the next is asked for."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """As that of `Source`."""

    def __len__(self) -> int:
        return self.num_gaussians

    def __iter__(self) -> Iterator[Gaussians]:
        """All chunks, in order.

        Raises:
            InputError: there are more or fewer rows than announced, or a chunk of another degree.
        """
        count = 0
        for chunk in self.make():
            count += len(chunk)
            if chunk.sh_degree != self.sh_degree:
                raise InputError(f"chunks: found harmonics of degree {chunk.sh_degree}, wanted {self.sh_degree}")
            yield chunk
        if count != self.num_gaussians:
            raise InputError(
                f"chunks: found {count} Gaussians, wanted {self.num_gaussians}; did the file change meanwhile?"
            )


def chunks_of(scene: Scene, *, rows: int = ROWS_PER_CHUNK) -> Chunks:
    """All rows of a scene, in views of ``rows`` rows."""
    g = scene.gaussians

    def make() -> Iterator[Gaussians]:
        for begin in range(0, len(g), rows):
            yield g.rows(begin, begin + rows)

    return Chunks(len(g), g.sh_degree, scene.mode, make, scene.source.metadata)


def repaired_chunks(chunks: Chunks, parts: Callable[[], Iterable[tuple[Gaussians, Counts]]]) -> Chunks:
    """Chunks of which repair may drop rows: ``parts``, with what was repaired in each, is gone through once to count them."""
    num_rows = 0
    repairs: Counts = json.loads(chunks.metadata.get("repairs", "{}"))
    for part, counts in parts():
        num_rows += len(part)
        for rule, count in counts.items():
            repairs[rule] = repairs.get(rule, 0) + count
    metadata = {**chunks.metadata, **({"repairs": json.dumps(repairs)} if repairs else {})}
    return replace(chunks, num_gaussians=num_rows, metadata=metadata)
