"""Names of the extensions and attributes of glTF that hold Gaussians, those of drafts included.

The extension was called CESIUM_gaussian_splatting and KHR_spz_gaussian_splats_compression before it became
KHR_gaussian_splatting with KHR_gaussian_splatting_compression_spz_2; attributes began with ``_`` before they began with its name.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

from splatree.errors import FormatError
from splatree.io import untrusted

__all__ = [
    "EXTENSION",
    "INSTANCES_EXTENSION",
    "PACKED_EXTENSIONS",
    "RTC_EXTENSION",
    "SPLAT_EXTENSIONS",
    "SPZ_EXTENSION",
    "VISIBILITY_EXTENSION",
    "attribute_names",
    "check_required",
    "packed_hint",
    "unknown_attributes",
]

EXTENSION: Final = "KHR_gaussian_splatting"
SPZ_EXTENSION: Final = "KHR_gaussian_splatting_compression_spz_2"
RTC_EXTENSION: Final = "CESIUM_RTC"

SPLAT_EXTENSIONS: Final = (EXTENSION, "CESIUM_gaussian_splatting", "CESIUM_gaussian_splats")
"""Extensions of a primitive whose points are Gaussians."""

PACKED_EXTENSIONS: Final = (
    SPZ_EXTENSION,
    "KHR_gaussian_splatting_compression_spz",
    "KHR_gaussian_splatting_spz_compression",
    "KHR_spz_gaussian_splats_compression",
    "KHR_spz_compression",
)
"""Extensions of a primitive, or of its splat extension, that hold an SPZ."""

VISIBILITY_EXTENSION: Final = "KHR_node_visibility"
INSTANCES_EXTENSION: Final = "EXT_mesh_gpu_instancing"

_UNDERSTOOD = {*SPLAT_EXTENSIONS, *PACKED_EXTENSIONS, RTC_EXTENSION, VISIBILITY_EXTENSION, "KHR_mesh_quantization"}
_HARMLESS = re.compile(r"KHR_(materials|texture|lights|xmp)\w*|EXT_(texture|lights)\w*")
"""Extensions of what is not drawn here."""

_UNPACK = "write the file without it (compression such as EXT_meshopt_compression can be undone with gltf-transform)"


_KNOWN_ATTRIBUTES = re.compile(
    rf"POSITION|COLOR_0|NORMAL|({EXTENSION}:|_)?(ROTATION|SCALE|OPACITY|SH_DEGREE_[0-3]_COEF_\d)"
)


def attribute_names(name: str) -> tuple[str, ...]:
    """The names under which a value of a Gaussian may stand, today's first."""
    if name in ("POSITION", "COLOR_0"):
        return (name,)
    return (f"{EXTENSION}:{name}", f"_{name}", name)


def unknown_attributes(names: Iterable[str]) -> list[str]:
    """The attributes of Gaussians that are not read here."""
    return [name for name in names if not _KNOWN_ATTRIBUTES.fullmatch(name)]


def packed_hint(content: Mapping[str, Any]) -> str:
    """Where numbers are missing, the extensions that the file uses and that are not known here: they may hold them."""
    used = content.get("extensionsUsed", [])
    names = [str(name)[:80] for name in used if not _is_known(str(name))] if isinstance(used, list) else []
    return f"; the file uses {', '.join(names)}, not known here: {_UNPACK}" if names else ""


def _is_known(name: str) -> bool:
    return name in _UNDERSTOOD or _HARMLESS.fullmatch(name) is not None


def check_required(content: Mapping[str, Any], where: str) -> None:
    """Refuse a file that says it cannot be read without what is not known here.

    Raises:
        FormatError: an extension is required that is not known.
    """
    for value in untrusted.as_list(content.get("extensionsRequired", []), f"{where}: extensionsRequired"):
        name = untrusted.as_text(value, f"{where}: extensionsRequired")
        if not _is_known(name):
            advice = "write each copy as a node of its own" if name == INSTANCES_EXTENSION else _UNPACK
            raise FormatError(
                f"{where}: requires the extension {name[:80]!r}, which is not known here, and would be read wrongly without it; "
                f"{advice}"
            )
