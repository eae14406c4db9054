"""``.glb`` and ``.gltf`` with Gaussians: KHR_gaussian_splatting, plain or packed (KHR_gaussian_splatting_compression_spz_2).

=====================================  ========  ==================================================================
attribute of a primitive of points     type      value
=====================================  ========  ==================================================================
POSITION                               3 f4      mean; x left, y up, z front (LUF)
KHR_gaussian_splatting:ROTATION        4 f4      unit quaternion xyzw; also i1, i2 normalized
KHR_gaussian_splatting:SCALE           3 f4      standard deviations (logarithms in drafts before 2026); also i1, i2
KHR_gaussian_splatting:OPACITY         f4        0 to 1; also u1, u2 normalized
KHR_gaussian_splatting:SH_DEGREE_l_…   3 f4      one harmonic, RGB
COLOR_0                                4 u1      colour and opacity for viewers that know points only
=====================================  ========  ==================================================================

Drafts of 2025 are read too: attributes ``_ROTATION``, ``_SCALE``, ``_OPACITY`` (or the alpha of COLOR_0), ``_SH_DEGREE_l_…``, and
the extensions that `glb/names.py` lists. A file that requires an extension which is not known is refused.

Our scenes are RDF: x and y change signs on the way, and with them quaternions and harmonics. All primitives that the nodes of the
file's scene show are one scene; a node may move, turn, scale, mirror and stretch them. `glb/writer.py` writes.
docs/reference/formats/glb.md.
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from io import BufferedReader
from math import isqrt
from pathlib import Path
from typing import Any, Final

import numpy as np

from splatree.constants import SH_C0
from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.budget import RowBudget
from splatree.io.check import finite_logits
from splatree.io.chunks import ROWS_PER_CHUNK, Chunks
from splatree.io.formats.glb.container import MAGIC, Accessor, GltfFile, Window
from splatree.io.formats.glb.names import (
    EXTENSION,
    INSTANCES_EXTENSION,
    PACKED_EXTENSIONS,
    RTC_EXTENSION,
    SPLAT_EXTENSIONS,
    VISIBILITY_EXTENSION,
    attribute_names,
    check_required,
    unknown_attributes,
)
from splatree.io.formats.spz import format as spz
from splatree.io.mirror import mirror
from splatree.io.options import ReadOptions
from splatree.io.placing import STRETCHED, Piece, Place, placed_chunks, stretches
from splatree.io.rows import FileRows, Fill, scene_of
from splatree.maths.axes import AXES, signs_between
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64

GLTF_AXES: Final = "LUF"
"""Axes of glTF: x left, y up, z front."""

SPZ_AXES: Final = "RUB"
"""Axes of an SPZ inside a glTF: those of the format's documents, as the extension demands."""

SPZ_AXES_KEY: Final = "splatree_spz_axes"
"""Key of our own in ``asset.extras``: other axes of an SPZ inside."""

_ROWS_PER_BYTE = 0.25
"""Rows that a byte of a glTF may stand for: a row takes 17 bytes and more, so a mesh may be shown four times and more often."""

_USUAL = {"projection": "perspective", "sortingMethod": "cameraDistance"}
"""How Gaussians are drawn, by the keys of the extension that name other ways."""

_NODES_MAX = 1 << 16
"""More nodes than this in a scene are refused."""


def _spz_axes(gltf: GltfFile) -> str:
    extras = untrusted.as_object(gltf.json["asset"], f"{gltf.where}: asset").get("extras")
    named = extras.get(SPZ_AXES_KEY) if isinstance(extras, dict) else None
    if named is None:
        return SPZ_AXES
    if named not in AXES:
        where = f"{gltf.where}: asset.extras.{SPZ_AXES_KEY}"
        raise FormatError(f"{where}: found {str(named)[:40]!r}, wanted one of {', '.join(AXES)}")
    return str(named)


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .glb of any kind, or JSON with that suffix."""
    return head[:4] == MAGIC or (path.suffix.lower() == ".gltf" and head.lstrip()[:1] == b"{")


def files(path: Path) -> list[Path]:
    """The file, and those of its buffers."""
    with path.open("rb") as file:
        return [path, *dict.fromkeys(GltfFile(path, file).files())]


def read(path: Path, options: ReadOptions) -> Scene:
    """Read all Gaussians that the file's scene shows, moved by its nodes in float64; far from zero relative to an origin."""
    return scene_of(read_chunks(path, options), f"read {path.name}")


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The same in chunks."""
    repair = bool(options.repair)
    with _opened(path, repair=repair) as (gltf, parts, lost):
        others = [part for part in parts if part.color_space != "srgb_rec709_display"]
        if others and not repair:
            raise FormatError(
                f"{others[0].where}: found colorSpace {others[0].color_space!r}, wanted 'srgb_rec709_display': these colours "
                "would be shown too dark; read it with repair to take them as they are"
            )
        modes = {part.rows.mode for part in parts}
        generator = gltf.json["asset"].get("generator")
    if len(modes) > 1:
        raise FormatError(f"{path}: found primitives drawn in different modes, wanted one")
    metadata = {"lost": json.dumps(lost)} if lost else {}
    if others:
        metadata["repairs"] = json.dumps({"other_color_space": len(others)})
    if isinstance(generator, str):
        metadata["generator"] = generator

    @contextmanager
    def pieces() -> Iterator[list[Piece]]:
        with _opened(path, repair=repair) as (_, parts, _):
            yield [part.piece() for part in parts]

    return placed_chunks(pieces, str(path), modes.pop(), metadata, repair=options.repair)


@contextmanager
def _opened(path: Path, *, repair: bool) -> Iterator[tuple[GltfFile, list["_Part"], list[str]]]:
    """The file, its primitives with Gaussians, and what else it shows."""
    with path.open("rb") as file:
        gltf = GltfFile(path, file)
        try:
            check_required(gltf.json, gltf.where)
            parts, lost = _parts(gltf, repair=repair)
            budget = RowBudget(str(path), _ROWS_PER_BYTE)
            for part in parts:
                num_rows = part.rows.num_rows
                budget.num_bytes = gltf.num_bytes
                budget.take(num_rows)
            yield gltf, parts, lost
        finally:
            gltf.close()


@dataclass(frozen=True, eq=False)
class _Part:
    """A primitive with Gaussians, as a node shows it."""

    gltf: GltfFile
    where: str
    primitive: dict[str, Any]
    extension: dict[str, Any]
    packed: tuple[str, Any] | None  # the extension that holds an SPZ in the place of attributes, by its name
    matrix: Float64[Array, "4 4"]  # of the node, to the scene, in the axes of glTF
    repair: bool  # whether opacities beyond 1 are left to the check of values

    @property
    def color_space(self) -> Any:
        """Of the colours; drafts had none."""
        return self.extension.get("colorSpace", "srgb_rec709_display")

    @cached_property
    def rows(self) -> FileRows:
        """The Gaussians in the axes of our scenes, where the primitive has them."""
        if self.packed is not None:
            name, packed = self.packed
            where = f"{self.where}: {name}"
            view = untrusted.field(untrusted.as_object(packed, where), "bufferView", where)
            file, start, size, _ = self.gltf.view(view, where)
            axes = _spz_axes(self.gltf)
            return spz.file_rows(lambda: BufferedReader(Window(file, start, size)), size, where, default_axes=axes)
        accessors = _attributes(self)
        extras = self.primitive.get("extras")
        is_mip = isinstance(extras, dict) and extras.get("SplatRenderMode") == "mip"
        mode: Mode = "antialiased" if is_mip else "classic"
        degree = isqrt(len(accessors.sh)) - 1
        decode = partial(_decoded, accessors, self.where, repair=self.repair)
        return FileRows(self.where, accessors.means.count, degree, decode, mode)

    def piece(self) -> Piece:
        """The Gaussians and where the node shows them."""
        signs = np.diag([*signs_between(GLTF_AXES, spz.SCENE_AXES).astype(np.float64), 1.0])
        place = Place.of(signs @ self.matrix @ signs, self.where)
        return Piece(self.rows.num_rows, self.rows.sh_degree, self.rows.parts, place)


def _parts(gltf: GltfFile, *, repair: bool) -> tuple[list[_Part], list[str]]:
    """All primitives with Gaussians that the scene shows, and what else it shows, a sentence each."""
    parts, num_others, others = [], 0, dict[str, None]()
    for name, mesh, matrix in _shown_meshes(gltf):
        primitives = untrusted.as_list(untrusted.field(mesh, "primitives", name), f"{name}: primitives")
        for i, value in enumerate(primitives):
            where = f"{name}: primitives[{i}]"
            primitive = untrusted.as_object(value, where)
            extensions = untrusted.as_object(primitive.get("extensions", {}), f"{where}: extensions")
            named = next((name for name in SPLAT_EXTENSIONS if name in extensions), None)
            extension = {} if named is None else untrusted.as_object(extensions[named], f"{where}: {named}")
            inner = untrusted.as_object(extension.get("extensions", {}), f"{where}: extensions")
            packed = next(((n, of[n]) for of in (inner, extensions) for n in PACKED_EXTENSIONS if n in of), None)
            if named is None and packed is None:
                num_others += 1
                continue
            kernel = extension.get("kernel", "ellipse")
            if kernel != "ellipse":
                raise FormatError(f"{where}: found kernel {kernel!r}, wanted 'ellipse'")
            for key, usual in _USUAL.items():
                if (found := extension.get(key, usual)) != usual:
                    others[f"the {key} {str(found)[:40]!r}: splatree draws by {usual!r}"] = None
            parts.append(_Part(gltf, where, primitive, extension, packed, matrix, repair))
    if not parts:
        raise FormatError(f"{gltf.where}: found no primitive with {EXTENSION}: this glTF shows no Gaussians")
    lost = [f"{num_others} primitives without Gaussians"] if num_others else []
    lost += [*others, *_unfollowed(gltf)]
    attributes = (part.primitive.get("attributes", {}) for part in parts if part.packed is None)
    extra = dict.fromkeys(name for names in attributes if isinstance(names, dict) for name in unknown_attributes(names))
    if extra:
        lost.append(f"the attributes {', '.join(extra)}: splatree does not know them, and draws without them")
    if any(stretches(part.matrix) and part.rows.sh_degree > 0 for part in parts):
        lost.append(STRETCHED)
    return parts, lost


def _unfollowed(gltf: GltfFile) -> Iterator[str]:
    """What of the file changes what is shown and is not followed."""
    if gltf.json.get("animations"):
        yield "the animations: everything is shown as it stands at rest"
    nodes = untrusted.as_list(gltf.json.get("nodes", []), f"{gltf.where}: nodes")
    if any(INSTANCES_EXTENSION in _extensions(node, f"{gltf.where}: nodes") for node in nodes):
        yield f"the copies of {INSTANCES_EXTENSION}: each mesh is shown once"


def _extensions(node: Any, where: str) -> dict[str, Any]:
    return untrusted.as_object(untrusted.as_object(node, where).get("extensions", {}), f"{where}: extensions")


def _is_hidden(node: dict[str, Any], where: str) -> bool:
    """Whether a node and all below it are not shown."""
    visibility = untrusted.as_object(_extensions(node, where).get(VISIBILITY_EXTENSION, {}), where)
    return visibility.get("visible", True) is False


def _shown_meshes(gltf: GltfFile) -> Iterator[tuple[str, dict[str, Any], Float64[Array, "4 4"]]]:
    """Name, mesh and matrix of each node of the scene that has a mesh; without scenes, of each mesh."""
    outermost = _center(gltf)
    if not gltf.json.get("scenes"):
        for i in range(len(untrusted.as_list(gltf.json.get("meshes", []), f"{gltf.where}: meshes"))):
            yield f"{gltf.where}: meshes[{i}]", gltf.item("meshes", i, gltf.where), outermost
        return
    scene = gltf.item("scenes", gltf.json.get("scene", 0), f"{gltf.where}: scene")
    waiting = [(node, outermost) for node in untrusted.as_list(scene.get("nodes", []), f"{gltf.where}: scene.nodes")]
    num_nodes = 0
    while waiting:
        index, above = waiting.pop()
        num_nodes += 1
        if num_nodes > min(_NODES_MAX, len(gltf.json.get("nodes", []))):
            raise FormatError(
                f"{gltf.where}: found more nodes below the scene than there are: a node has two parents, or is its own"
            )
        node = gltf.item("nodes", index, f"{gltf.where}: a node")
        name = f"{gltf.where}: nodes[{index}]"
        if _is_hidden(node, name):
            continue
        matrix = above @ _matrix(node, name)
        children = untrusted.as_list(node.get("children", []), f"{name}.children")
        waiting += [(child, matrix) for child in reversed(children)]
        if "mesh" in node:
            yield name, gltf.item("meshes", node["mesh"], f"{name}.mesh"), matrix


def _center(gltf: GltfFile) -> Float64[Array, "4 4"]:
    """What moves the whole file: the centre of CESIUM_RTC, in the axes of glTF."""
    matrix = np.eye(4)
    extensions = untrusted.as_object(gltf.json.get("extensions", {}), f"{gltf.where}: extensions")
    if RTC_EXTENSION in extensions:
        where = f"{gltf.where}: {RTC_EXTENSION}"
        matrix[:3, 3] = untrusted.numbers(untrusted.as_object(extensions[RTC_EXTENSION], where), "center", where, (3,))
    return matrix


def _matrix(node: dict[str, Any], where: str) -> Float64[Array, "4 4"]:
    """From the node to its parent: a matrix column by column, or translation, rotation xyzw and scale."""
    if "matrix" in node:
        return np.asarray(untrusted.numbers(node, "matrix", where, (16,)).reshape(4, 4).T)
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = untrusted.numbers(node, "rotation", where, (4,))
        length = math.sqrt(x * x + y * y + z * z + w * w)
        if length == 0:
            raise FormatError(f"{where}.rotation: found 0, wanted a unit quaternion")
        w, v = w / length, np.array([x, y, z]) / length
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        matrix[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    if "scale" in node:
        matrix[:3, :3] *= untrusted.numbers(node, "scale", where, (3,))
    if "translation" in node:
        matrix[:3, 3] = untrusted.numbers(node, "translation", where, (3,))
    return matrix


@dataclass(frozen=True)
class _Attributes:
    """Accessors of a primitive."""

    means: Accessor
    quats: Accessor
    scales: Accessor
    opacities: Accessor
    sh: list[Accessor]  # by coefficient, or COLOR_0 alone
    is_color: bool


def _attributes(part: _Part) -> _Attributes:
    """The accessors, whose rows and widths fit together."""
    where = f"{part.where}: attributes"
    named = untrusted.as_object(part.primitive.get("attributes", {}), where)

    def accessor(name: str, *widths: int) -> Accessor:
        key = next((key for key in attribute_names(name) if key in named), attribute_names(name)[0])
        found = part.gltf.accessor(untrusted.field(named, key, where), f"{where}.{key}")
        if found.width not in widths:
            raise FormatError(
                f"{where}.{key}: found {found.width} numbers a row, wanted {' or '.join(map(str, widths))}"
            )
        return found

    def has(name: str) -> bool:
        return any(key in named for key in attribute_names(name))

    means = accessor("POSITION", 3)
    quats, scales = accessor("ROTATION", 4), accessor("SCALE", 3)
    opacities = accessor("COLOR_0", 4) if not has("OPACITY") and has("COLOR_0") else accessor("OPACITY", 1)
    degree = max((d for d in range(1, 4) if has(f"SH_DEGREE_{d}_COEF_0")), default=0)
    has_dc = has("SH_DEGREE_0_COEF_0")
    is_color = not has_dc and has("COLOR_0")
    names = [f"SH_DEGREE_{d}_COEF_{i}" for d in range(degree + 1) for i in range(2 * d + 1)]
    sh = [accessor("COLOR_0", 3, 4) if is_color and name == names[0] else accessor(name, 3) for name in names]
    for other in (quats, scales, opacities, *sh):
        if other.count != means.count:
            raise FormatError(f"{other.where}: found {other.count} rows, wanted {means.count}, as many as of POSITION")
    return _Attributes(means, quats, scales, opacities, sh, is_color)


@contextmanager
def _decoded(a: _Attributes, where: str, *, repair: bool) -> Iterator[Fill]:
    """Decodes rows into the axes of our scenes."""
    n, signs = a.means.count, signs_between(GLTF_AXES, spz.SCENE_AXES)
    # Drafts had logarithms here; a standard deviation below 0 says that these are.
    least = [a.scales.rows(begin, min(begin + ROWS_PER_CHUNK, n)).min() for begin in range(0, n, ROWS_PER_CHUNK)]
    is_linear = n == 0 or float(np.min(least)) >= 0

    def fill(begin: int, out: Gaussians) -> None:
        end = begin + len(out)
        out.means[:] = a.means.rows(begin, end)
        xyzw = a.quats.rows(begin, end)
        out.quats[:, 0], out.quats[:, 1:] = xyzw[:, 3], xyzw[:, :3]
        out.log_scales[:] = a.scales.rows(begin, end)
        for k, accessor in enumerate(a.sh):
            out.sh[:, k] = accessor.rows(begin, end)[:, :3]
        opacities = a.opacities.rows(begin, end)[:, -1]  # the alpha of a colour, or the opacity alone
        beyond = np.flatnonzero(~((opacities >= 0) & (opacities <= 1)))
        if len(beyond) and not repair:
            raise FormatError(
                f"{where}: row {begin + int(beyond[0])}: found an opacity of {opacities[beyond[0]]:g}, wanted 0 to 1; whole "
                "numbers have to be normalized, as their accessor says"
            )
        with np.errstate(all="ignore"):  # whatever comes of absurd values is found by the check of values
            out.logit_opacities[:] = _logits(opacities)
            if a.is_color:
                out.sh[:, 0] = (out.sh[:, 0] - np.float32(0.5)) / np.float32(SH_C0)
            if is_linear:
                np.log(out.log_scales, out=out.log_scales)
        mirror(out, signs)

    yield fill


def _logits(opacities: Array) -> Array:
    """Logits, in float64 so that those of opacities near 1 keep what float32 has of them."""
    share = opacities.astype(np.float64)
    return finite_logits(np.log(share / (1 - share)))
