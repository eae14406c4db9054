"""Which properties of a .ply make which column, and what becomes of the others.

A property that no column takes is left out. Most of these do not change the picture (labels, features) and are named under
``lost``. Some do: motion in time, other kernels. Then the Gaussians alone are a wrong picture, and the file is refused unless it
is read with ``ignore_properties``.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from splatree.errors import FormatError
from splatree.io.formats.ply.header import Header

__all__ = ["DC", "FILTER", "GEOMETRY", "NORMALS", "RGB", "Fields", "fields_of", "sh_fields"]

GEOMETRY = (
    ("x", "y", "z"),
    ("rot_0", "rot_1", "rot_2", "rot_3"),
    ("scale_0", "scale_1", "scale_2"),
    ("opacity",),
)
"""Properties of the columns means, quats, log_scales, logit_opacities."""

DC = ("f_dc_0", "f_dc_1", "f_dc_2")
RGB = ("red", "green", "blue")
NORMALS = ("nx", "ny", "nz")
FILTER = "filter_3D"

_NUM_REST = {0: 0, 9: 1, 24: 2, 45: 3, 72: 4}
"""Degree by the number of properties f_rest."""

_CHANGING = (
    (
        r"t|time|t_\d+|t_center|t_mean|scale_t(_\d+)?|t_scale|rot_r_\d+|rot_t_\d+|trbf_\w+|motion(_\w+)?|omega_\w+|"
        r"velocity(_\w+)?|vel_\w+|v[xyz]|lifespan|life_?time|duration|d[xyz]_\w+|delta_\w+|deform\w*|polynomial_\w+|fourier_\w+",
        "motion in time (4D Gaussians)",
    ),
    (
        r"betas?(_\d+)?|sb_params_\w+|shapes?(_\d+)?|nu(_degree)?(_\d+)?|kurtosis|gamma(_\d+)?|kernel_\w+|exponents?(_\d+)?|"
        r"convex_\w+|num_points_\w+|delta|sigma|half_\w+|negative",
        "a kernel that is not a Gaussian",
    ),
    (
        r"f_(asg|app|appearance|view|mlp|latent|hash|tcnn|neural)\w*|mlp_\w+|embedding\w*|sg_\w+|vmf_\w+|asg_\w+",
        "colours that a network or another basis makes for each view",
    ),
)
"""Names of properties that change the picture, and what they are."""


@dataclass(frozen=True)
class Fields:
    """Where the values of a file go."""

    columns: list[list[str]]
    """Properties of each column, the harmonics coefficient by coefficient with RGB inside; last the 3D filter, if any."""
    degree: int
    """Degree of the harmonics that are kept."""
    has_filter: bool
    """Whether the last column is the 3D filter."""
    extra: list[str]
    """Properties that no column takes."""
    lost: list[str]
    """What is left out, a sentence each."""


def fields_of(path: Path, header: Header, *, ignore: bool) -> Fields:
    """Say where the values go.

    Raises:
        FormatError: properties are missing; or some would change the picture, and ``ignore`` is not set.
    """
    names, lost = header.names, list[str]()
    if "packed_position" in names:
        raise FormatError(f"{path}: found packed_position beside other elements than those of a compressed .ply")
    if "f_anchor_feat_0" in names or "f_offset_0" in names:
        raise FormatError(
            f"{path}: found f_anchor_feat: these are anchors of Scaffold-GS or Octree-GS, whose Gaussians a network makes for "
            "each view; wanted Gaussians: bake them with the program that trained them"
        )
    color = RGB if DC[0] not in names and RGB[0] in names else DC
    missing = [name for name in (*(n for group in GEOMETRY for n in group), *color) if name not in names]
    geometry: tuple[tuple[str, ...], ...] = GEOMETRY
    if missing == ["scale_2"]:
        geometry = tuple(tuple("scale_0" if n == "scale_2" else n for n in group) for group in GEOMETRY)  # a stand-in
    elif missing and set(missing) <= set(DC):
        raise FormatError(
            f"{path}: found Gaussians without colours (only {' '.join(list(names)[:12])} …), wanted the properties f_dc_0 f_dc_1 "
            "f_dc_2 or red green blue"
        )
    elif missing:
        is_partial = any(name in names for group in GEOMETRY[1:] for name in group)
        what = "the file is of another layout" if is_partial else "this is a point cloud or a mesh"
        raise FormatError(
            f"{path}: found no properties {' '.join(missing)} (only {' '.join(list(names)[:12])} …): {what}, wanted trained "
            "Gaussians"
        )
    if missing or header.are_surfels:
        lost.append(
            "the surfels' own rule of drawing (2DGS): they are read as Gaussians, flat ones if they have two scales"
        )
    num_rest = sum(re.fullmatch(r"f_rest_\d+", name) is not None for name in names)
    degree = _NUM_REST.get(num_rest)
    if degree is None or any(f"f_rest_{i}" not in names for i in range(num_rest)):
        raise FormatError(
            f"{path}: found {num_rest} properties f_rest_*, wanted 0, 9, 24, 45 or 72, numbered from 0 (degree 0 to 4)"
        )
    if degree == 4:
        lost.append("the harmonics of degree 4")
    columns = [*(list(group) for group in geometry), sh_fields(color, degree, min(degree, 3))]
    has_filter = FILTER in names
    if has_filter:
        columns.append([FILTER])
    columns = [[names[n] for n in group] for group in columns]
    coded = [
        n
        for group in columns[1:]
        for n in group
        if header.dtype[n].kind != "f" and n not in (names.get(c) for c in RGB)
    ]
    if coded:
        raise FormatError(
            f"{path}: found {_listed(coded)} as whole numbers, which are codes of a program of its own; wanted floats: save the "
            "scene without quantisation"
        )
    used = {name for group in columns for name in group}
    understood = used | {names[n] for n in (*NORMALS, *RGB, "alpha") if n in names and (n in NORMALS or color == DC)}
    understood |= {full for bare, full in names.items() if re.fullmatch(r"f_rest_\d+", bare)}
    extra = [name for name in header.dtype.names or () if name not in understood]
    lost += _losses(path, header, extra, ignore)
    return Fields(columns, min(degree, 3), has_filter, extra, lost)


def _losses(path: Path, header: Header, extra: Iterable[str], ignore: bool) -> list[str]:
    """What is left out with the extra properties and elements; an error if it changes the picture."""
    bare = {full: name for name, full in header.names.items() if name != full}
    others = list(extra)
    lost = []
    for pattern, what in _CHANGING:
        found = [name for name in others if re.fullmatch(pattern, bare.get(name, name), re.IGNORECASE)]
        if not found:
            continue
        others = [name for name in others if name not in found]
        if not ignore:
            raise FormatError(
                f"{path}: found {what}, the properties {_listed(found)}: the picture of the Gaussians alone would be wrong; read "
                "it with ignore_properties (--ignore-properties) to take them as they stand"
            )
        lost.append(
            f"{what}, the properties {_listed(found)}: the picture of the Gaussians alone is not that of the file"
        )
    if others:
        lost.append(f"the properties {_listed(others)}: splatree does not know them, and draws without them")
    if header.others:
        lost.append(f"the elements {_listed(header.others)}: splatree does not know them, and draws without them")
    return lost


def _listed(names: list[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def sh_fields(color: tuple[str, ...], degree: int, kept: int) -> list[str]:
    """Properties of the harmonics up to degree ``kept`` in a file of ``degree``, coefficient by coefficient."""
    num_file, num_kept = (degree + 1) ** 2 - 1, (kept + 1) ** 2 - 1
    return [*color, *(f"f_rest_{channel * num_file + j}" for j in range(num_kept) for channel in range(3))]
