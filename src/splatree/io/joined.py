"""Several scenes as one: chunks of a large capture, joined in order."""

import json
from collections.abc import Sequence

import numpy as np

from splatree.errors import InputError
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.scene.tree import GaussianTree


def joined(scenes: Sequence[Scene]) -> Scene:
    """All rows of ``scenes`` in order; their trees side by side; harmonics at the highest degree among them.

    Raises:
        InputError: the scenes are drawn in different modes or with different thresholds.
    """
    if len(scenes) == 1:
        return scenes[0]
    for name in ("mode", "threshold"):
        values = {getattr(scene, name): scene for scene in scenes}
        if len(values) > 1:
            found = ", ".join(f"{' '.join(scene.source.paths)} with {value}" for value, scene in values.items())
            raise InputError(
                f"inputs differ in their {name}: {found}; wanted scenes of one training, read them one by one"
            )

    starts = np.cumsum([0, *(len(scene) for scene in scenes)])
    if starts[-1] >= 2**31:
        raise InputError(f"inputs hold {starts[-1]} Gaussians together, wanted less than 2^31 in one scene")
    tree = GaussianTree(
        subtree_end=np.concatenate(
            [s.tree.subtree_end + np.int32(start) for s, start in zip(scenes, starts, strict=False)]
        ),
        depth=np.concatenate([s.tree.depth for s in scenes]),
        extents=np.concatenate([s.tree.extents for s in scenes]),
    )
    return Scene(
        Gaussians.concatenate([s.gaussians for s in scenes]),
        tree,
        ids=None if all(s.ids is None for s in scenes) else np.arange(starts[-1], dtype=np.uint32),
        mode=scenes[0].mode,
        threshold=scenes[0].threshold,
        source=_source([s.source for s in scenes]),
    )


def _source(sources: Sequence[Source]) -> Source:
    """Paths of all; metadata that all agree on as it is, counts of repairs added up, the rest as a list in JSON."""
    metadata: dict[str, str] = {}
    for key in dict.fromkeys(key for source in sources for key in source.metadata):
        values = [source.metadata[key] for source in sources if key in source.metadata]
        if key == "repairs":
            counts: dict[str, int] = {}
            for value in values:
                for rule, count in json.loads(value).items():
                    counts[rule] = counts.get(rule, 0) + count
            metadata[key] = json.dumps(counts)
        else:
            same = len(set(values)) == 1 and len(values) == len(sources)
            metadata[key] = values[0] if same else json.dumps(values)
    formats = dict.fromkeys(source.format for source in sources)
    return Source(tuple(path for source in sources for path in source.paths), " + ".join(formats), metadata)
