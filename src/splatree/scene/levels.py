"""How the levels of a tree were made, and so how they are to be drawn.

A tree says which nodes stand for which. It does not say from which size on a node is good enough. That depends on how the
levels were made. `LevelRecord` holds this knowledge beside the tree (`GaussianTree.record`), and the selection takes its
default profile from there.

Every rule makes extents that allow the profile `sphere`. Levels that `build_lod` makes are drawn by their extents, profile
`pixel`. Files of before have levels by a radius whose extents are balls: their record says `exact`, and they are drawn by that.
"""

import dataclasses
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode, Profile
from splatree.scene.thinning import Importance, MergeOptions
from splatree.scene.trial import MethodTrial

__all__ = [
    "UNKNOWN_LEVELS",
    "LevelRecord",
    "LevelRule",
    "common_record",
    "has_extents_of_levels",
    "record_from_fields",
]

LevelRule = Literal["radius-thinning", "pairs", "grown", "linked", "foreign", "mixed"]
"""How levels were made: `radius-thinning` and `pairs` by `build_lod`; `grown` in training (`TrainOptions.levels`); `linked` by
`link_levels`; `foreign` by another program, whose rule the file does not name; `mixed`: trees of several rules, joined."""


@dataclass(frozen=True)
class LevelRecord:
    """How the levels of a tree were made. A field is None if it does not apply, is unknown, or differs between joined trees.

    Example:
        >>> record = st.build_lod(st.read("city.ply")).tree.record
        >>> record.profile, st.LevelRecord.from_json(record.to_json()) == record
        ('pixel', True)
    """

    rule: LevelRule
    """How the levels were made."""
    profile: Profile
    """The profile that the levels were made for. A selection uses it unless another is named."""
    mode: Mode | None = None
    """The mode of the scene that the merged nodes were made for."""
    steps: tuple[float, ...] = ()
    """Size of each level, world units, ascending: its radius, or the width of its pixel for the rule `pairs`."""
    growth: float | None = None
    """Factor from the size of one level to the next."""
    merge: MergeOptions | None = None
    """How a group became one node, with everything filled in."""
    importance: Importance | None = None
    """`radius-thinning`: which of two close Gaussians a group forms around."""
    color_radius: float | None = None
    """`radius-thinning`: the distance in linear RGB that counts as much as the radius in space; None: colour did not count."""
    visibility: bool | None = None
    """Whether hidden Gaussians counted less in what was merged; None: not known."""
    trial: MethodTrial | None = None
    """How both methods did on a sample of the scene; None: the method was named, and none was tried."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not all(0 <= step <= 1e300 for step in self.steps) or sorted(self.steps) != list(self.steps):
            raise InputError(f"LevelRecord.steps: found {self.steps}, wanted sizes of 0 or more, finite, ascending")
        if self.growth is not None and not 1 < self.growth <= 1e6:
            raise InputError(f"LevelRecord.growth: found {self.growth}, wanted more than 1, at most 1e6")
        if self.color_radius is not None and not self.color_radius > 0:
            raise InputError(f"LevelRecord.color_radius: found {self.color_radius}, wanted more than 0")

    def scaled(self, factor: float) -> "LevelRecord":
        """The record of the same levels in a scene whose lengths were multiplied by ``factor``."""
        return dataclasses.replace(self, steps=tuple(step * factor for step in self.steps))

    def to_json(self) -> str:
        """The record as a JSON object; fields that are None are left out."""
        fields = {name: value for name, value in dataclasses.asdict(self).items() if value is not None}
        return json.dumps(fields)

    @staticmethod
    def from_json(text: str) -> "LevelRecord":
        """The record that `to_json` wrote.

        Raises:
            InputError: the text is not such a record.
        """
        try:
            fields = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"level record: not valid JSON ({error})") from error
        return record_from_fields(fields)


UNKNOWN_LEVELS = LevelRecord("foreign", "exact")
"""The record of levels of which nothing is known."""


def record_from_fields(fields: Any) -> LevelRecord:
    """A record from parsed JSON.

    Raises:
        InputError: a field is unknown or its value cannot be used.
    """
    if not isinstance(fields, dict) or "rule" not in fields:
        raise InputError(f"level record: found {str(fields)[:80]}, wanted an object with a field 'rule'")
    fields = dict(fields)
    try:
        if fields.get("merge") is not None:
            fields["merge"] = MergeOptions(**fields["merge"])
        fields.pop("quality", None)  # of older files, which kept a prediction of what is measured now
        if fields.get("trial") is not None:
            fields["trial"] = MethodTrial(**fields["trial"])
        fields["steps"] = tuple(float(step) for step in fields.get("steps", ()))
        return LevelRecord(**fields)
    except (TypeError, ValueError) as error:
        raise InputError(f"level record: found {str(fields)[:200]}, which cannot be used ({error})") from error


def has_extents_of_levels(record: LevelRecord | None) -> bool:
    """Whether extents of merged nodes say how coarse their level is. All others are radii of balls around what is below."""
    return record is not None and record.profile == "pixel"


def common_record(records: Iterable[LevelRecord]) -> LevelRecord | None:
    """The record of trees that stand side by side in one scene; None if there are no records.

    What all agree on is kept, and the sizes of all levels are listed together. Trees of different rules are `mixed`. Where the
    profiles differ, the profile is `sphere`: the extents that every rule makes allow it.
    """
    known = list(records)
    if not known:
        return None
    agreed = {
        f.name: getattr(known[0], f.name)
        for f in dataclasses.fields(LevelRecord)
        if all(getattr(record, f.name) == getattr(known[0], f.name) for record in known)
    }
    steps = tuple(sorted({step for record in known for step in record.steps}))
    return LevelRecord(**{"rule": "mixed", "profile": "sphere", **agreed, "steps": steps})
