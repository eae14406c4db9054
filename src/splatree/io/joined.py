"""Several scenes as one: chunks of a large capture, joined in order.

A chunk is appended as it arrives and then given back, so the peak is the joined scene and one chunk. The columns grow by
`ndarray.resize`, which moves large blocks by their pages and does not copy them.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from itertools import chain

import numpy as np

from splatree.errors import InputError
from splatree.io.notes import with_notes
from splatree.maths.axes import AXES
from splatree.scene.gaussians import Gaussians
from splatree.scene.levels import UNKNOWN_LEVELS, LevelRecord, common_record
from splatree.scene.origin import Origin, coarsest_step
from splatree.scene.scene import NEAR_KEY, Scene, Source
from splatree.scene.tree import GaussianTree
from splatree.shapes import Array

_STEP_MAX = 1e-3
"""World units: coordinates that have an origin of their own are metres on a map, and a step of a millimetre is seen near by."""


def joined(scenes: Iterable[Scene]) -> Scene:
    """All rows of ``scenes`` in order; their trees side by side; harmonics at the highest degree among them.

    What the trees say of their levels is kept as far as they agree (`scene.levels.common_record`): trees of different rules are
    drawn by the profile `sphere`, which all extents allow. A scene without levels goes with any.

    Raises:
        InputError: the scenes differ in mode, threshold or tile rule, or have too many rows together.
    """
    remaining = iter(scenes)
    first = next(remaining)
    second = next(remaining, None)
    if second is None:
        return first

    gaussians = _empty(Gaussians.empty(first.gaussians.sh_degree))
    tree = _empty(GaussianTree(np.zeros(0, np.int32), np.zeros(0, np.uint8), np.zeros(0, np.float32)))
    drawn = {name: getattr(first, name) for name in ("mode", "threshold", "tile_rule")}
    origin = first.source.origin
    curves, follows = list[Array](), False
    has_ids, sources, records, start = False, list[Source](), list[LevelRecord](), 0
    for scene in chain((first, second), remaining):
        first = second = None  # type: ignore[assignment]  # let go of what is appended
        for name, wanted in drawn.items():
            if (found := getattr(scene, name)) != wanted:
                raise InputError(
                    f"inputs differ in their {name}: {' '.join(scene.source.paths)} has {found}, those before it {wanted}; "
                    "wanted scenes of one training, read them one by one; `splatree convert --mode` writes one in another mode"
                )
        part, end = relative_to(scene.gaussians, scene.source.origin, origin), start + len(scene)
        if end >= 2**31:
            raise InputError(f"inputs hold more than {end} Gaussians together, wanted less than 2^31 in one scene")
        degree = max(part.sh_degree, int(np.sqrt(gaussians["sh"].shape[1])) - 1)
        if gaussians["sh"].shape[1] < (degree + 1) ** 2:
            gaussians["sh"] = Gaussians(**gaussians).with_sh_degree(degree).sh
        _append(gaussians, vars(part.with_sh_degree(degree)))
        _append(tree, {**vars(scene.tree), "subtree_end": scene.tree.subtree_end + np.int32(start)})
        curves.append(scene.tree.curves if scene.tree.curves is not None else np.zeros((len(scene), 4), np.float32))
        follows |= scene.tree.curves is not None
        if scene.tree.depth.any():
            records.append(scene.tree.record or UNKNOWN_LEVELS)
        has_ids |= scene.ids is not None
        sources.append(scene.source)
        start = end
    return Scene(
        Gaussians(**gaussians),
        GaussianTree(
            tree["subtree_end"],
            tree["depth"],
            tree["extents"],
            np.concatenate(curves) if follows else None,
            common_record(records),
        ),
        ids=np.arange(start, dtype=np.uint32) if has_ids else None,
        **drawn,
        source=with_notes(joined_source(sources), [f"{len(sources)} inputs were joined as one scene"]),
    )


def relative_to(gaussians: Gaussians, old: Origin, new: Origin) -> Gaussians:
    """Gaussians whose means are relative to one origin, relative to another: moved in float64."""
    if old == new:
        return gaussians
    means = gaussians.means.astype(np.float64) + (np.asarray(old) - np.asarray(new))
    return replace(gaussians, means=means.astype(np.float32))


def _empty(struct: Gaussians | GaussianTree) -> dict[str, Array]:
    columns = {f.name: getattr(struct, f.name) for f in fields(struct)}
    return {name: column.copy() for name, column in columns.items() if isinstance(column, np.ndarray)}


def _append(columns: dict[str, Array], parts: dict[str, Array]) -> None:
    for name, column in columns.items():
        start = len(column)
        column.resize((start + len(parts[name]), *column.shape[1:]), refcheck=False)  # nothing else looks into it yet
        column[start:] = parts[name]


def joined_source(sources: Sequence[Source]) -> Source:
    """Paths of all; metadata that all agree on as it is, counts of repairs added up, losses and notes named once, the rest as a
    list in JSON.

    Raises:
        InputError: the axes of some were assumed, and those of others are not the same.
    """
    metadata: dict[str, str] = {}
    for key in dict.fromkeys(key for source in sources for key in source.metadata):
        values = [source.metadata[key] for source in sources if key in source.metadata]
        if key == "repairs":
            counts: dict[str, int] = {}
            for value in values:
                for rule, count in json.loads(value).items():
                    counts[rule] = counts.get(rule, 0) + count
            metadata[key] = json.dumps(counts)
        elif key == NEAR_KEY:
            metadata[key] = str(min(source.near for source in sources))
        elif key in ("lost", "notes"):
            metadata[key] = json.dumps(
                list(dict.fromkeys(sentence for value in values for sentence in json.loads(value)))
            )
        else:
            if key == "axes":
                _refuse_mixed(values)
            same = len(set(values)) == 1 and len(values) == len(sources)
            metadata[key] = values[0] if same else json.dumps(values)
    if coarse := list(_coarse(sources)):
        metadata["lost"] = json.dumps([*json.loads(metadata.get("lost", "[]")), *coarse])
    formats = dict.fromkeys(source.format for source in sources)
    paths = tuple(path for source in sources for path in source.paths)
    return Source(paths, " + ".join(formats), metadata, sources[0].origin)


def _coarse(sources: Sequence[Source]) -> Iterator[str]:
    """What is lost of inputs that lie so far from the origin of the first one that float32 rounds their places visibly."""
    first = sources[0].origin
    steps = [coarsest_step(max(abs(a - b) for a, b in zip(source.origin, first, strict=True))) for source in sources]
    if (step := max(steps)) > _STEP_MAX:
        names = [" ".join(source.paths) for source, each in zip(sources, steps, strict=True) if each > _STEP_MAX]
        yield (
            f"the places of {', '.join(names)}: so far from the first input that float32 keeps them to steps of {step:g} world "
            "units; read such inputs one by one"
        )


def _refuse_mixed(axes: Sequence[str]) -> None:
    """Refuse cells of one scene of which one would be turned and another not, by a guess."""
    guesses = set(axes) - set(AXES)
    if guesses and len({each[:3] for each in axes}) > 1:
        raise InputError(
            f"inputs differ in their axes: found {' and '.join(sorted(set(axes)))}, wanted those of one scene; say where "
            "x, y and z point with --input-axes, or read them one by one"
        )
