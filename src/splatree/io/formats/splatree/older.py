"""How levels were made, from files that are older than `LevelRecord`: they say it in the scene's provenance alone.

``source.metadata["levels"]`` then holds a JSON object with the rule, sizes and options; after joining several scenes, a list of
such texts.
"""

import json
from typing import Any

from splatree.errors import InputError
from splatree.scene.levels import UNKNOWN_LEVELS, LevelRecord, common_record, record_from_fields

__all__ = ["record_of_provenance"]

_PROFILE_FROM_RULE = {"radius-thinning": "exact", "pairs": "pixel", "linked": "sphere"}
_FIELDS = ("rule", "mode", "growth", "merge", "importance", "color_radius", "visibility")


def record_of_provenance(text: str | None) -> LevelRecord:
    """The record of levels of which only a text is known; of unknown levels where the text says nothing of use."""
    try:
        report = json.loads(text or "{}")
        parts = [json.loads(part) for part in report] if isinstance(report, list) else [report]
    except (ValueError, TypeError, RecursionError):  # a file may carry any text under this name
        return UNKNOWN_LEVELS
    return common_record(_record(part) for part in parts) or UNKNOWN_LEVELS


def _record(report: Any) -> LevelRecord:
    rule = report.get("rule") if isinstance(report, dict) else None
    if not isinstance(rule, str) or rule not in _PROFILE_FROM_RULE:
        return UNKNOWN_LEVELS
    fields = {name: report[name] for name in _FIELDS if name in report}
    steps = report.get("radii", report.get("pixel_sizes", ()))
    try:
        return record_from_fields({**fields, "profile": _PROFILE_FROM_RULE[rule], "steps": steps})
    except InputError:
        return record_from_fields({"rule": rule, "profile": _PROFILE_FROM_RULE[rule]})
