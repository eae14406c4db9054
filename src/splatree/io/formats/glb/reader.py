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

Our scenes are RDF: x and y change signs on the way, and with them quaternions and harmonics. All primitives that the nodes of the
file's scene show are one scene; a node may move, turn and scale them. `glb/writer.py` writes. docs/reference/formats/glb.md.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from splatree.constants import SH_C0
from splatree.edit.similarity import Similarity
from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.check import checked, finite_logits
from splatree.io.chunks import ROWS_PER_CHUNK
from splatree.io.formats.glb.container import MAGIC, Accessor, GltfFile
from splatree.io.formats.spz import format as spz
from splatree.io.mirror import mirror
from splatree.io.options import ReadOptions
from splatree.maths.axes import signs_between
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.origin import NO_ORIGIN, Origin, origin_of
from splatree.scene.scene import Scene, Source
from splatree.shapes import Array, Float64

EXTENSION: Final = "KHR_gaussian_splatting"
SPZ_EXTENSION: Final = "KHR_gaussian_splatting_compression_spz_2"

RTC_EXTENSION: Final = "CESIUM_RTC"

GLTF_AXES: Final = "LUF"
"""Axes of glTF: x left, y up, z front."""

SPZ_AXES: Final = "RUB"
"""Axes of an SPZ inside a glTF: those of the format's documents, as the extension demands."""

_NODES_MAX = 1 << 16
"""More nodes than this in a scene are refused."""


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file is a .glb of any kind, or JSON with that suffix."""
    return head[:4] == MAGIC or (path.suffix.lower() == ".gltf" and head.lstrip()[:1] == b"{")


@np.errstate(all="ignore")  # whatever comes of absurd values is found by the check of values
def read(path: Path, options: ReadOptions) -> Scene:
    """Read all Gaussians that the file's scene shows, moved by its nodes in float64; far from zero relative to an origin."""
    with path.open("rb") as file:
        gltf = GltfFile(path, file)
        try:
            parts, lost = _parts(gltf)
            gaussians, modes, places = [], set(), list[Float64[Array, "n 3"] | None]()
            repairs: dict[str, int] = {}
            for part in parts:
                if part.color_space != "srgb_rec709_display":
                    if not options.repair:
                        raise FormatError(
                            f"{part.where}: found colorSpace {part.color_space!r}, wanted 'srgb_rec709_display': these colours "
                            "would be shown too dark; read it with repair to take them as they are"
                        )
                    repairs["other_color_space"] = repairs.get("other_color_space", 0) + 1
                g, mode = part.decode(path)
                placed, means = part.placed(g)
                gaussians.append(placed)
                places.append(means)
                modes.add(mode)
        finally:
            gltf.close()
    if len(modes) > 1:
        raise FormatError(f"{path}: found primitives drawn in different modes, wanted one")
    metadata = {"lost": json.dumps(lost)} if lost else {}
    if repairs:
        metadata["repairs"] = json.dumps(repairs)
    generator = gltf.json["asset"].get("generator")
    if isinstance(generator, str):
        metadata["generator"] = generator
    origin = _settle(gaussians, places)
    whole = gaussians[0] if len(gaussians) == 1 else Gaussians.concatenate(gaussians)
    scene = Scene.flat(whole, mode=modes.pop(), source=Source(metadata=metadata, origin=origin))
    return checked(scene, str(path), repair=options.repair)


@dataclass(frozen=True, eq=False)
class _Part:
    """A primitive with Gaussians, as a node shows it."""

    gltf: GltfFile
    where: str
    primitive: dict[str, Any]
    extension: dict[str, Any]
    matrix: Float64[Array, "4 4"]  # of the node, to the scene, in the axes of glTF

    @property
    def color_space(self) -> Any:
        """Of the colours; drafts had none."""
        return self.extension.get("colorSpace", "srgb_rec709_display")

    def decode(self, path: Path) -> tuple[Gaussians, Mode]:
        """The Gaussians in the axes of our scenes, where the primitive has them."""
        extensions = self.extension.get("extensions", {})
        packed = extensions.get(SPZ_EXTENSION) if isinstance(extensions, dict) else None
        if packed is not None:
            where = f"{self.where}: {SPZ_EXTENSION}"
            view = untrusted.field(untrusted.as_object(packed, where), "bufferView", where)
            file, start, size, _ = self.gltf.view(view, where)
            file.seek(start)
            data = file.read(size)
            scene = spz.file_rows(lambda: BytesIO(data), size, where, default_axes=SPZ_AXES).unchecked_scene()
            return scene.gaussians, scene.mode
        gaussians = _decoded(self.where, _attributes(self), path)
        mirror(gaussians, signs_between(GLTF_AXES, spz.SCENE_AXES))
        extras = self.primitive.get("extras")
        is_mip = isinstance(extras, dict) and extras.get("SplatRenderMode") == "mip"
        return gaussians, "antialiased" if is_mip else "classic"

    def placed(self, gaussians: Gaussians) -> tuple[Gaussians, Float64[Array, "n 3"] | None]:
        """The Gaussians turned and scaled as the node shows them, and their means; None: as they are."""
        linear = self.matrix[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        rotation = linear / scale if scale > 0 else linear
        # Within float32, as which matrices are stored.
        if not (scale > 0 and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)):
            raise FormatError(
                f"{self.where}: found a node that mirrors, shears or stretches it ({linear.round(6).tolist()}), wanted one "
                "that moves, turns and scales all axes alike"
            )
        signs = signs_between(GLTF_AXES, spz.SCENE_AXES).astype(np.float64)
        if np.array_equal(self.matrix, np.eye(4)):
            return gaussians, None
        turned = rotation * signs[:, None] * signs
        means = scale * gaussians.means.astype(np.float64) @ turned.T + self.matrix[:3, 3] * signs
        return Similarity(scale, turned).gaussians(gaussians), means


def _settle(gaussians: list[Gaussians], places: list[Float64[Array, "n 3"] | None]) -> Origin:
    """Put the Gaussians to their places, relative to an origin if these lie far off; return it."""
    origin = NO_ORIGIN
    if any(place is not None for place in places):
        rows = 1 << 16
        every = max(1, sum(map(len, gaussians)) // rows)
        means = [g.means.astype(np.float64) if p is None else p for g, p in zip(gaussians, places, strict=True)]
        sample = np.concatenate([m[::every] for m in means])
        origin = origin_of(sample, np.concatenate([g.log_scales[::every] for g in gaussians]))
        for i, (g, m) in enumerate(zip(gaussians, means, strict=True)):
            if places[i] is not None or origin != NO_ORIGIN:
                gaussians[i] = replace(g, means=(m - np.asarray(origin)).astype(np.float32))
    return origin


def _parts(gltf: GltfFile) -> tuple[list[_Part], list[str]]:
    """All primitives with Gaussians that the scene shows, and what else it shows, a sentence each."""
    parts, num_others = [], 0
    for name, mesh, matrix in _shown_meshes(gltf):
        primitives = untrusted.as_list(untrusted.field(mesh, "primitives", name), f"{name}: primitives")
        for i, value in enumerate(primitives):
            where = f"{name}: primitives[{i}]"
            primitive = untrusted.as_object(value, where)
            extensions = untrusted.as_object(primitive.get("extensions", {}), f"{where}: extensions")
            if EXTENSION not in extensions:
                num_others += 1
                continue
            extension = untrusted.as_object(extensions[EXTENSION], f"{where}: {EXTENSION}")
            kernel = extension.get("kernel", "ellipse")
            if kernel != "ellipse":
                raise FormatError(f"{where}: found kernel {kernel!r}, wanted 'ellipse'")
            parts.append(_Part(gltf, where, primitive, extension, matrix))
    if not parts:
        raise FormatError(f"{gltf.where}: found no primitive with {EXTENSION}: this glTF shows no Gaussians")
    return parts, [f"{num_others} primitives without Gaussians"] if num_others else []


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
        found = part.gltf.accessor(untrusted.field(named, name, where), f"{where}.{name}")
        if found.width not in widths:
            raise FormatError(
                f"{where}.{name}: found {found.width} numbers a row, wanted {' or '.join(map(str, widths))}"
            )
        return found

    prefix = f"{EXTENSION}:"
    means = accessor("POSITION", 3)
    quats, scales = accessor(f"{prefix}ROTATION", 4), accessor(f"{prefix}SCALE", 3)
    opacities = accessor(f"{prefix}OPACITY", 1)
    degree = max((d for d in range(1, 4) if f"{prefix}SH_DEGREE_{d}_COEF_0" in named), default=0)
    is_color = f"{prefix}SH_DEGREE_0_COEF_0" not in named and degree == 0 and "COLOR_0" in named
    names = [f"{prefix}SH_DEGREE_{d}_COEF_{i}" for d in range(degree + 1) for i in range(2 * d + 1)]
    sh = [accessor("COLOR_0", 3, 4)] if is_color else [accessor(name, 3) for name in names]
    for other in (quats, scales, opacities, *sh):
        if other.count != means.count:
            raise FormatError(f"{other.where}: found {other.count} rows, wanted {means.count}, as many as of POSITION")
    return _Attributes(means, quats, scales, opacities, sh, is_color)


def _decoded(where: str, a: _Attributes, path: Path) -> Gaussians:
    """The Gaussians in the axes of glTF."""
    n = a.means.count
    means, quats, scales, logits = (np.empty(shape, np.float32) for shape in ((n, 3), (n, 4), (n, 3), (n,)))
    sh = np.empty((n, len(a.sh), 3), np.float32)
    with task(f"read {path.name}", n) as advance:
        for begin in range(0, n, ROWS_PER_CHUNK):
            end = min(begin + ROWS_PER_CHUNK, n)
            rows = slice(begin, end)
            means[rows] = a.means.rows(begin, end)
            xyzw = a.quats.rows(begin, end)
            quats[rows, 0], quats[rows, 1:] = xyzw[:, 3], xyzw[:, :3]
            scales[rows] = a.scales.rows(begin, end)
            logits[rows] = _logits(a.opacities.rows(begin, end)[:, 0])
            for k, accessor in enumerate(a.sh):
                sh[rows, k] = accessor.rows(begin, end)[:, :3]
            advance(end - begin)
    if a.is_color:
        sh[:] = (sh - np.float32(0.5)) / np.float32(SH_C0)
    # Drafts had logarithms here; a standard deviation below 0 says that these are.
    if n == 0 or float(scales.min()) >= 0:
        np.log(scales, out=scales)
    return Gaussians(means, quats, scales, logits, sh)


def _logits(opacities: Array) -> Array:
    """Logits, in float64 so that those of opacities near 1 keep what float32 has of them."""
    share = opacities.astype(np.float64)
    return finite_logits(np.log(share / (1 - share)))
