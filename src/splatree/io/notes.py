"""What a reader did that the user should know: sentences in ``Source.metadata["notes"]``, a list in JSON, and counts of what it
repaired in ``Source.metadata["repairs"]``, an object."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

from splatree.scene.origin import NO_ORIGIN, Origin
from splatree.scene.scene import Source

__all__ = [
    "gaussians_in_words",
    "notes_in",
    "origin_in_words",
    "origin_note",
    "repairs_in",
    "repairs_in_words",
    "sentences_in",
    "with_notes",
]


def gaussians_in_words(count: int) -> str:
    """How many: 1 Gaussian, 2,000 Gaussians."""
    return f"{count:,} Gaussian{'s' * (count != 1)}"


def origin_note(origin: Origin) -> str:
    """That coordinates are relative to an origin."""
    return (
        f"coordinates lie so far from zero that float32 would round them coarsely: they are kept relative to the origin "
        f"{origin_in_words(origin)}, which formats that can hold one give back"
    )


def origin_in_words(origin: Origin) -> str:
    """Its three numbers with all digits that they need."""
    return "(" + ", ".join(f"{x:.15g}" for x in origin) + ")"


def notes_in(metadata: Mapping[str, str], origin: Origin) -> tuple[str, ...]:
    """What the reader of a scene noted, and its origin."""
    notes = sentences_in(metadata, "notes")
    return (*notes, origin_note(origin)) if origin != NO_ORIGIN else notes


def repairs_in(metadata: Mapping[str, str]) -> dict[str, int]:
    """How many values or rows each rule of repair touched when a scene was read."""
    return dict(json.loads(metadata.get("repairs", "{}")))


def repairs_in_words(repairs: Mapping[str, int]) -> str:
    """Each rule with its count: clamped_scales 1, dropped_rows 2,000."""
    return ", ".join(f"{rule} {count:,}" for rule, count in repairs.items())


def with_notes(source: Source, notes: Sequence[str]) -> Source:
    """The source with more notes."""
    if not notes:
        return source
    text = json.dumps([*sentences_in(source.metadata, "notes"), *notes])
    return replace(source, metadata={**source.metadata, "notes": text})


def sentences_in(metadata: Mapping[str, str], key: str) -> tuple[str, ...]:
    """A list of sentences in JSON; none if there is none."""
    return tuple(json.loads(metadata.get(key, "[]")))
