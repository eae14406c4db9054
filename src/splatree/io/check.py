"""Values that no renderer can use: found in one fast pass, refused with the first of them named, or repaired and counted.

=================  =============================================  ===========================================
column             wanted                                         repair
=================  =============================================  ===========================================
means              finite, magnitude ≤ 1e15                       the row is dropped
sh                 finite, magnitude ≤ 1e6                        the row is dropped
log_scales         finite, magnitude ≤ 30                         clamped; the row is dropped if NaN
logit_opacities    not NaN                                        the row is dropped
quats              length 1e-12 to 1e12                           normalised; zero becomes the identity; the
                                                                  row is dropped if not finite
=================  =============================================  ===========================================

An infinite logit is an opacity of 0 or 1, which other tools write for the codes 0 and 255 of formats of 8 bits: readers take it
for ±13.8, as readers of such formats take these codes, and count it like a repair.

The limits keep squares and products of float32 finite all through a frame. Repairs are counted in the scene's metadata under
``repairs``. The rows of a scene with levels cannot be dropped (its tree counts on them): such a scene is refused instead.

Every reader ends with `checked`; a writer that computes with the values begins with `refuse_unusable`. Cost: each byte of the
scene is read once, unless the reader brings the largest magnitudes along; the masks of the diagnosis are built only for a bad
scene.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from splatree.errors import FormatError
from splatree.io.options import Repair
from splatree.kernels.cpu.codec.columns import largest_magnitude, shortest
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Float32

MEAN_MAX = 1e15
"""World units; squared distances stay below 3.4e38."""

SH_MAX = 1e6
"""A sum of 16 harmonics of this size is finite and any picture of it white or black."""

LOG_SCALE_MAX = 30.0
"""e^30 = 1e13 and e^-30 = 1e-13 world units; variances and their products stay finite and normal."""

QUAT_MIN, QUAT_MAX = 1e-12, 1e12
"""Length of a quaternion whose square float32 holds with full precision."""

LOGIT_CERTAIN = math.log((1 - 1e-6) / 1e-6)
"""13.8: logit of an opacity of 1 − 1e-6, which no picture tells from 1."""

_SHARE = np.clip(np.arange(256) / 255, 1e-6, 1 - 1e-6)
LOGIT_FROM_BYTE = np.log(_SHARE / (1 - _SHARE)).astype(np.float32)
"""Logit of an opacity of 8 bits; 0 and 255 have none and are read as 1e-6 and 1 − 1e-6."""


Magnitudes = Mapping[str, float]
"""Largest magnitude of each column of `Gaussians`, NaN if it holds one."""


def checked(scene: Scene, where: str, *, repair: Repair, magnitudes: Magnitudes | None = None) -> Scene:
    """The scene itself if all of its values can be used; else an error or, with ``repair``, a repaired copy.

    Raises:
        FormatError: with the first bad row, its column, the value found and what was wanted.
    """
    gaussians, magnitudes, repairs = _with_finite_logits(scene.gaussians, magnitudes or magnitudes_of(scene.gaussians))
    if _is_clean(gaussians, magnitudes):
        return replace(scene, gaussians=gaussians, source=_noted(scene.source, repairs)) if repairs else scene
    if repair and scene.tree.num_leaves != len(scene):
        raise FormatError(
            f"{_describe(gaussians, where)}; a scene with levels cannot be repaired, build it again from its source"
        )
    gaussians, more = _mended(gaussians, where, repair, first_row=0)
    flat = Scene.flat(gaussians, mode=scene.mode, source=_noted(scene.source, repairs | more))
    return replace(flat, threshold=scene.threshold, tile_rule=scene.tile_rule)


def checked_rows(
    gaussians: Gaussians, where: str, *, repair: Repair, magnitudes: Magnitudes | None = None, first_row: int = 0
) -> tuple[Gaussians, dict[str, int]]:
    """As `checked`, of a part of a file that starts at ``first_row``; also how many values or rows each rule touched."""
    gaussians, magnitudes, repairs = _with_finite_logits(gaussians, magnitudes or magnitudes_of(gaussians))
    if _is_clean(gaussians, magnitudes):
        return gaussians, repairs
    gaussians, more = _mended(gaussians, where, repair, first_row)
    return gaussians, repairs | more


def refuse_unusable(
    gaussians: Gaussians, where: str, *, magnitudes: Magnitudes | None = None, first_row: int = 0
) -> None:
    """Refuse values that cannot be used, infinite logits too: of rows to be written, of which ``first_row`` is the first.

    Raises:
        FormatError: as `checked`.
    """
    if not _is_clean(gaussians, magnitudes or magnitudes_of(gaussians)):
        raise FormatError(_describe(gaussians, where, first_row))


def _with_finite_logits(gaussians: Gaussians, magnitudes: Magnitudes) -> tuple[Gaussians, Magnitudes, dict[str, int]]:
    """Infinite logits as ±13.8, the magnitudes after that, and how many there were. NaN stays."""
    logits = gaussians.logit_opacities
    if math.isfinite(magnitudes["logit_opacities"]) or not (infinite := np.isinf(logits)).any():
        return gaussians, magnitudes, {}
    logits = finite_logits(logits)
    magnitudes = {**magnitudes, "logit_opacities": largest_magnitude(logits)}
    return replace(gaussians, logit_opacities=logits), magnitudes, {"clamped_opacities": int(infinite.sum())}


def finite_logits(logits: Array) -> Float32[Array, "n"]:
    """Those of opacities of 0 and 1 as ±13.8, the others as they are."""
    return np.asarray(np.where(np.isinf(logits), np.copysign(LOGIT_CERTAIN, logits), logits), np.float32)


def _noted(source: Source, repairs: dict[str, int]) -> Source:
    counts = json.dumps(add_counts(source.metadata.get("repairs"), repairs))
    return replace(source, metadata={**source.metadata, "repairs": counts})


def _mended(gaussians: Gaussians, where: str, repair: Repair, first_row: int) -> tuple[Gaussians, dict[str, int]]:
    if not repair:
        raise FormatError(f"{_describe(gaussians, where, first_row)}, read it with repair to fix or drop them")
    return without_unusable(gaussians) if repair == "drop" else repaired(gaussians)


def without_unusable(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """Without the rows that break any rule of the table above, and how many these were."""
    bad = np.zeros(len(gaussians), bool)
    for problem in _problems(gaussians):
        bad |= problem.mask.reshape(len(gaussians), -1).any(axis=1)
    return (gaussians.take(~bad), {"dropped_rows": int(bad.sum())}) if bad.any() else (gaussians, {})


def magnitudes_of(gaussians: Gaussians, **known: float) -> Magnitudes:
    """Largest magnitude of each column; those that are ``known`` are taken as they are."""
    return known | {
        column.name: largest_magnitude(getattr(gaussians, column.name))
        for column in fields(gaussians)
        if column.name not in known
    }


def add_counts(old: str | None, more: dict[str, int]) -> dict[str, int]:
    """Counts of the JSON string ``old`` plus ``more``."""
    counts: dict[str, int] = json.loads(old) if old else {}
    for rule, count in more.items():
        counts[rule] = counts.get(rule, 0) + count
    return counts


def repaired(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """Repair by the table above; return the Gaussians and how many values or rows each rule touched."""
    g = gaussians
    with np.errstate(invalid="ignore", over="ignore"):
        lengths = np.linalg.norm(g.quats.astype(np.float64), axis=1)
        drop = ~(np.abs(g.means) <= MEAN_MAX).all(axis=1)
        drop |= ~(np.abs(g.sh) <= SH_MAX).all(axis=(1, 2))
        drop |= np.isnan(g.log_scales).any(axis=1) | np.isnan(g.logit_opacities) | ~np.isfinite(lengths)
    keep = np.flatnonzero(~drop)
    counts = {"dropped_rows": int(drop.sum())}
    g, lengths = g.take(keep), lengths[keep]

    log_scales = np.clip(g.log_scales, -LOG_SCALE_MAX, LOG_SCALE_MAX).astype(np.float32)
    counts["clamped_scales"] = int((log_scales != g.log_scales).any(axis=1).sum())
    quats = g.quats.copy()
    odd = (lengths < QUAT_MIN) | (lengths > QUAT_MAX)
    counts["repaired_quaternions"] = int(odd.sum())
    quats[odd & (lengths > 0)] = (g.quats / np.where(lengths > 0, lengths, 1)[:, None])[odd & (lengths > 0)]
    quats[lengths == 0] = (1, 0, 0, 0)
    fixed = Gaussians(g.means, quats, log_scales, g.logit_opacities, g.sh)
    return fixed, {rule: count for rule, count in counts.items() if count}


def are_within(g: Gaussians, magnitudes: Magnitudes) -> bool:
    """Whether the largest magnitudes, and the shortest quaternion, say that all values can be used; else look at each."""
    return (
        magnitudes["means"] <= MEAN_MAX
        and magnitudes["sh"] <= SH_MAX
        and magnitudes["log_scales"] <= LOG_SCALE_MAX
        and math.isfinite(magnitudes["logit_opacities"])
        and magnitudes["quats"] <= QUAT_MAX / 2  # then no length is above the limit
        and shortest(g.quats) >= 2 * QUAT_MIN  # nor below: float32 squares lose nothing near here
    )


def _is_clean(g: Gaussians, magnitudes: Magnitudes) -> bool:
    return are_within(g, magnitudes) or not any(problem.mask.any() for problem in _problems(g))


@dataclass(frozen=True)
class _Problem:
    column: str
    wanted: str
    mask: Array  # [n] or [n …]: where the column breaks the rule


def _problems(g: Gaussians) -> Iterator[_Problem]:
    with np.errstate(invalid="ignore", over="ignore"):
        yield _Problem("means", f"finite and at most {MEAN_MAX:g} in magnitude", ~(np.abs(g.means) <= MEAN_MAX))
        yield _Problem(
            "log_scales", f"between −{LOG_SCALE_MAX:g} and {LOG_SCALE_MAX:g}", ~(np.abs(g.log_scales) <= LOG_SCALE_MAX)
        )
        yield _Problem("logit_opacities", "a finite number", ~np.isfinite(g.logit_opacities))
        lengths = np.linalg.norm(g.quats.astype(np.float64), axis=1)
        wanted = f"a finite length between {QUAT_MIN:g} and {QUAT_MAX:g}"
        yield _Problem("quats", wanted, ~((lengths >= QUAT_MIN) & (lengths <= QUAT_MAX)))
        yield _Problem("sh", f"finite and at most {SH_MAX:g} in magnitude", ~(np.abs(g.sh) <= SH_MAX))


def _describe(g: Gaussians, where: str, first_row: int = 0) -> str:
    """The first bad row of the first column that has one, and how many rows are bad in all."""
    problems = [problem for problem in _problems(g) if problem.mask.any()]
    first = problems[0]
    index = tuple(int(i) for i in np.argwhere(first.mask)[0])
    found = getattr(g, first.column)[index].tolist()
    bad_rows = np.zeros(len(g), bool)
    for problem in problems:
        bad_rows |= problem.mask.reshape(len(g), -1).any(axis=1)
    inner = "".join(f"[{i}]" for i in index[1:])
    return (
        f"{where}: row {first_row + index[0]}, {first.column}{inner}: found {found}, wanted {first.wanted}; "
        f"{bad_rows.sum()} of {len(g)} rows{f' from {first_row} on' if first_row else ''} have such values"
    )
