"""Gaussians in chunks, to be gone through as often as a writer likes: a scene in memory or a file that is larger than it.

A format that can be written chunk by chunk has ``write_chunks`` in place of ``write``: then the same lines write a scene and a
stream, so both give the same bytes. One that can be read so has ``read_chunks`` beside ``read``. `splatree.io.convert` joins
the two; its memory is a few chunks.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import InputError
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin
from splatree.scene.scene import Scene, Source

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
    repairs: Counts = field(default_factory=dict)
    """What reading had to change, by rule; whole after the first pass."""
    origin: Origin = NO_ORIGIN
    """As that of `Source`."""
    paths: tuple[str, ...] = ()
    """As those of `Source`."""
    format: str = ""
    """As that of `Source`."""
    threshold: float = ALPHA_THRESHOLD
    """τ of the scene."""
    num_merged: int = 0
    """Merged nodes of the scene, where these are its leaves alone."""
    num_clusters: int = 0
    """Clusters of the scene, which are left out too."""

    @property
    def source(self) -> Source:
        """Where the rows come from; without what reading had to change, which is known after a pass."""
        return Source(self.paths, self.format, self.metadata, self.origin)

    def __len__(self) -> int:
        return self.num_gaussians

    def __iter__(self) -> Iterator[Gaussians]:
        """All chunks that have rows, in order.

        Raises:
            InputError: there are more or fewer rows than announced, or a chunk of another degree.
        """
        count = 0
        for chunk in self.make():
            count += len(chunk)
            if chunk.sh_degree != self.sh_degree:
                raise InputError(f"chunks: found harmonics of degree {chunk.sh_degree}, wanted {self.sh_degree}")
            if count > self.num_gaussians:  # writers have room for no more
                break
            if len(chunk):  # a filter may leave none
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

    source = scene.source
    return Chunks(
        *(len(g), g.sh_degree, scene.mode, make, source.metadata),
        origin=source.origin,
        paths=source.paths,
        format=source.format,
    )


def counted_chunks(
    parts: Callable[[], Iterable[tuple[Gaussians, Counts]]],
    num_rows: int,
    sh_degree: int,
    mode: Mode,
    metadata: Mapping[str, str],
    *,
    drops_rows: bool,
    origin: Origin = NO_ORIGIN,
) -> Chunks:
    """The chunks of ``parts``, which come with what reading had to change in each; where it may drop some of the ``num_rows``,
    they are gone through once to count those that are left."""
    repairs: Counts = {}

    def make() -> Iterator[Gaussians]:
        counts: Counter[str] = Counter()
        for part, more in parts():
            counts.update(more)
            yield part
        repairs.update(counts)  # each pass finds the same

    num_left = sum(map(len, make())) if drops_rows else num_rows
    return Chunks(num_left, sh_degree, mode, make, metadata, repairs, origin)
