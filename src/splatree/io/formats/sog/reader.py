"""SOG (PlayCanvas): Gaussians as the pixels of a few lossless WebP pictures, versions 1 and 2.

A folder with ``meta.json`` and pictures, or the same as a ZIP bundle ``.sog``. Pixel i (row by row) is Gaussian i:

- means: 16 bits, low and high byte in two pictures: ``m = min + (max − min) u / 65535``, ``x = sign(m) (e^|m| − 1)``;
- quats: alpha − 252 is the index of the largest component (wxyz), RGB the others in order, ``(2 v / 255 − 1) / √2``;
- scales, sh0: version 2 looks each byte up in a codebook of 256 values; version 1 spreads it between min and max;
- opacity, the alpha of sh0: version 2 stores the opacity, version 1 its logit;
- shN: each Gaussian has a 16-bit label into a palette of harmonics, a picture of 64 entries a row.

Each step is a table of 256 or 65,536 entries computed in float64, so decoding is a handful of look-ups in the native core, some
rows at a time; the WebP decoding costs most, and its pictures are decoded by all processors at once. Layout and deviations:
docs/reference/formats/sog.md.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from splatree.errors import FormatError
from splatree.io import untrusted
from splatree.io.chunks import Chunks
from splatree.io.options import ReadOptions
from splatree.io.rows import FileRows
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.codec.sog import SogTables, decode
from splatree.progress import task
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array

if TYPE_CHECKING:
    import zipfile

    from PIL.Image import Image

_GAUSSIANS_PER_BYTE = 16
"""More Gaussians than this for a byte of the pictures (real ones hold one in 16 to 40 bytes) is a decompression bomb …"""

_GAUSSIANS_ALWAYS = 1 << 20
"""… unless there are no more than this: then all pictures together take 30 MB."""

_INFLATION_MAX = 16
"""A ZIP entry that promises to grow by more than this is refused: WebP does not compress further."""

_NUM_REST = {1: 3, 2: 8, 3: 15}
"""Harmonics beyond the DC of each degree."""

_PALETTE_MAX = 1 << 16

ReadBytes = Callable[[str], bytes]

T = TypeVar("T")


def sniff(path: Path, head: bytes) -> bool:
    """Whether the path is a folder with meta.json, that file, or a ZIP bundle with one."""
    if path.is_dir():
        return (path / "meta.json").is_file()
    if head[:4] == b"PK\x03\x04":
        import zipfile

        try:
            with path.open("rb") as file, zipfile.ZipFile(file) as bundle:
                return _meta_in(bundle) is not None
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
            return path.suffix.lower() == ".sog"
    return path.name == "meta.json" and head.lstrip()[:1] == b"{"


def read(path: Path, options: ReadOptions) -> Scene:
    """Read a folder, its meta.json, or a .sog bundle."""
    return _open(path, options).scene(options)


def read_chunks(path: Path, options: ReadOptions) -> Chunks:
    """The same values in chunks; the pictures are decoded once and kept, 17 to 20 bytes a Gaussian."""
    return _open(path, options).chunks(options)


def files(path: Path) -> list[Path]:
    """A bundle; or the meta.json of a folder, and the pictures that it names."""
    if path.is_file() and path.name != "meta.json":
        return [path]
    folder = path if path.is_dir() else path.parent
    meta = untrusted.as_object(untrusted.read_json(folder / "meta.json"), f"{folder}/meta.json")
    names = _Meta(meta, f"{folder}/meta.json").file_names
    return [folder / "meta.json", *(untrusted.inner_file(folder, name, "meta.json") for name in names)]


def open_rows(path: Path, options: ReadOptions) -> FileRows:
    """All rows, whatever their values: a range of a streamed scene counts on their places. Any of them may be asked for."""
    return _open(path, options)


@dataclass(frozen=True)
class Head:
    """What a SOG says of itself before its pictures are decoded."""

    num_rows: int
    """Gaussians."""
    sh_degree: int
    """Degree of the harmonics."""
    mode: Mode
    """How the scene is drawn."""


def read_head(path: Path) -> Head:
    """The head of a folder, its meta.json, or a .sog bundle."""
    return _opened(path, _head)


def rows_of_files(files: Mapping[str, bytes], where: str) -> FileRows:
    """The rows of a meta.json and its pictures, which another file holds, by their names."""

    def read_bytes(name: str) -> bytes:
        if name not in files:
            raise FormatError(f"{where}: found no picture {name!r}, only {sorted(files)}; the file is damaged")
        return files[name]

    return _rows(Path(where), where, read_bytes, ReadOptions())


def _open(path: Path, options: ReadOptions) -> FileRows:
    return _opened(path, lambda where, read_bytes: _rows(path, where, read_bytes, options))


def _opened(path: Path, use: Callable[[str, ReadBytes], T]) -> T:
    """What ``use`` makes of the files of a folder or bundle; it is given its name in errors, and how a file is read."""
    if path.is_file() and path.name != "meta.json":
        import zipfile

        try:
            with path.open("rb") as file, zipfile.ZipFile(file) as bundle:
                place = (_meta_in(bundle) or "meta.json").removesuffix("meta.json")
                return use(str(path), lambda name: _zip_entry(path, bundle, place + name))
        except (zipfile.BadZipFile, EOFError, NotImplementedError, ValueError) as error:
            if isinstance(error, FormatError):
                raise
            raise FormatError(f"{path}: not a whole ZIP bundle ({error}); fetch it again") from error
    folder = path if path.is_dir() else path.parent
    return use(str(folder), lambda name: _folder_file(folder, name))


def _head(where: str, read_bytes: ReadBytes) -> Head:
    sog = _Meta(_meta_of(where, read_bytes), f"{where}/meta.json")
    degree = 0
    if "shN" in sog.files:
        name = sog.files["shN"][0]
        degree = sog.rest_degree or _degree(sog, _picture(f"{sog.where}: {name}", read_bytes(name), lambda p: p.width))
    return Head(sog.count, degree, sog.mode)


def _meta_of(where: str, read_bytes: ReadBytes) -> dict[str, Any]:
    path = f"{where}/meta.json"
    return untrusted.as_object(untrusted.parse_json(read_bytes("meta.json"), path), path)


def _rows(path: Path, where: str, read_bytes: ReadBytes, options: ReadOptions) -> FileRows:
    """Read and decode all pictures."""
    meta = _meta_of(where, read_bytes)
    sog = _Meta(meta, f"{where}/meta.json")
    data = {name: read_bytes(name) for name in sog.file_names}
    num_bytes = sum(map(len, data.values()))
    if sog.count > max(_GAUSSIANS_ALWAYS, _GAUSSIANS_PER_BYTE * num_bytes):
        raise FormatError(
            f"{where}/meta.json: found {sog.count} Gaussians in pictures of {num_bytes} bytes, wanted at most "
            f"{_GAUSSIANS_PER_BYTE} a byte; the count is wrong or the file is a decompression bomb"
        )
    pixels, palette = _decode(sog, data)
    degree, entries = (0, None) if palette is None else _palette(sog, palette)
    tables = SogTables(sog.mean_tables, sog.scale_tables, sog.dc_tables, sog.logit_table, sog.rest_table, entries)

    def fill(begin: int, out: Gaussians) -> None:
        rows = slice(begin, begin + len(out))
        damage = decode({name: codes[rows] for name, codes in pixels.items()}, tables, out)
        if damage.tag >= 0 and not options.repair:  # the check of values counts and repairs it
            row = begin + damage.tag
            raise FormatError(
                f"{sog.where}: row {row}, quats: found tag {pixels['quats'][row, 3]}, wanted 252 to 255 in alpha; "
                "the picture is damaged, read it with repair to give such rows no rotation"
            )
        if damage.label >= 0 and entries is not None:
            row = begin + damage.label
            low, high = pixels["labels"][row, :2].tolist()
            raise FormatError(
                f"{sog.where}: row {row}, shN label: found {low + 256 * high}, wanted less than the {len(entries)} entries "
                "of the palette"
            )

    metadata = {"version": str(sog.version)}
    if isinstance(generator := meta.get("asset"), dict) and isinstance(generator.get("generator"), str):
        metadata["generator"] = generator["generator"]
    return FileRows(str(path), sog.count, degree, lambda: nullcontext(fill), sog.mode, metadata)


class _Meta:
    """The fields of meta.json, checked."""

    @np.errstate(over="ignore", invalid="ignore")  # absurd ranges give values that the check of values finds
    def __init__(self, meta: dict[str, Any], where: str) -> None:
        self.where = where
        self.version = untrusted.integer(meta, "version", where, low=1, high=2) if "version" in meta else 1
        means, scales, quats, sh0 = (self._section(meta, key) for key in ("means", "scales", "quats", "sh0"))
        if self.version == 2:
            self.count = untrusted.integer(meta, "count", where)
            self.scale_tables = np.tile(self._codebook(scales, "scales"), (3, 1))
            self.dc_tables = np.tile(self._codebook(sh0, "sh0"), (3, 1))
            share = np.clip(np.arange(256) / 255, 1e-6, 1 - 1e-6)  # 0 and 255 stand for opacities that have no logit
            self.logit_table = np.log(share / (1 - share)).astype(np.float32)
        else:
            shape = untrusted.as_list(untrusted.field(means, "shape", f"{where}: means"), f"{where}: means.shape")
            self.count = untrusted.as_integer(shape[0] if shape else None, f"{where}: means.shape[0]")
            self.scale_tables = self._ranges(scales, "scales", 3)
            colors = self._ranges(sh0, "sh0", 4)
            self.dc_tables, self.logit_table = colors[:3], colors[3]
        self.mode = self._mode(meta)

        low, high = (untrusted.numbers(means, key, f"{where}: means", (3,)) for key in ("mins", "maxs"))
        m = low[:, None] + (high - low)[:, None] * (np.arange(1 << 16) / 65535)  # [3 65536]
        self.mean_tables = (np.sign(m) * np.expm1(np.abs(m))).astype(np.float32)

        self.files = {
            "means": self._files(means, "means", 2),
            "scales": self._files(scales, "scales", 1),
            "quats": self._files(quats, "quats", 1),
            "sh0": self._files(sh0, "sh0", 1),
        }
        self.rest_table: Array | None = None
        self.rest_count: int | None = None
        self.rest_degree: int | None = None
        if meta.get("shN") is not None:
            rest = self._section(meta, "shN")
            self.files["shN"] = self._files(rest, "shN", 2)
            if self.version == 2:
                self.rest_table = self._codebook(rest, "shN")
                self.rest_degree = untrusted.integer(rest, "bands", f"{where}: shN", low=1, high=3)
                self.rest_count = untrusted.integer(rest, "count", f"{where}: shN", low=1, high=_PALETTE_MAX)
            else:
                rest_low, rest_high = (untrusted.number(rest, key, f"{where}: shN") for key in ("mins", "maxs"))
                self.rest_table = (rest_low + (rest_high - rest_low) * (np.arange(256) / 255)).astype(np.float32)

    @property
    def file_names(self) -> list[str]:
        """All pictures."""
        return [name for names in self.files.values() for name in names]

    def _section(self, meta: dict[str, Any], key: str) -> dict[str, Any]:
        return untrusted.as_object(untrusted.field(meta, key, self.where), f"{self.where}: {key}")

    def _codebook(self, section: dict[str, Any], key: str) -> Array:
        return untrusted.numbers(section, "codebook", f"{self.where}: {key}", (256,)).astype(np.float32)

    def _ranges(self, section: dict[str, Any], key: str, channels: int) -> Array:
        low, high = (untrusted.numbers(section, end, f"{self.where}: {key}", (channels,)) for end in ("mins", "maxs"))
        return (low[:, None] + (high - low)[:, None] * (np.arange(256) / 255)).astype(np.float32)

    def _files(self, section: dict[str, Any], key: str, count: int) -> list[str]:
        where = f"{self.where}: {key}.files"
        names = untrusted.as_list(untrusted.field(section, "files", f"{self.where}: {key}"), where)
        if len(names) != count or not all(isinstance(name, str) for name in names):
            raise FormatError(f"{where}: found {str(names)[:200]}, wanted {count} file names")
        return [untrusted.inner_path(name, where) for name in names]

    def _mode(self, meta: dict[str, Any]) -> Mode:
        if meta.get("antialias") is True:
            return "antialiased"
        match meta.get("model", "default"):
            case "default":
                return "classic"
            case "antialiased":
                return "antialiased"
            case other:
                raise FormatError(f"{self.where}: found model {str(other)[:80]!r}, wanted 'default' or 'antialiased'")


def _decode(sog: _Meta, data: dict[str, bytes]) -> tuple[dict[str, Array], Array | None]:
    """The first ``count`` pixels "n c" of each picture, and the picture of the palette if there is one.

    The pictures are decoded on all processors; ``data`` is let go of on the way.
    """
    from concurrent.futures import ThreadPoolExecutor

    means_low, means_high = sog.files["means"]
    wanted = {"means_l": (means_low, 3), "means_u": (means_high, 3), "quats": (sog.files["quats"][0], 4)}
    wanted |= {"scales": (sog.files["scales"][0], 3), "sh0": (sog.files["sh0"][0], 4)}
    if "shN" in sog.files:
        centroids, labels = sog.files["shN"]
        wanted |= {"centroids": (centroids, 3), "labels": (labels, 3)}
    pixels: dict[str, Array] = {}
    with task(f"decode {sog.where}", len(wanted)) as advance, ThreadPoolExecutor(_core.hardware_threads()) as pool:

        def decoded(part: str) -> Array:
            name, channels = wanted[part]
            image = _with_channels(_image(f"{sog.where}: {name}", data.pop(name)), channels)
            return image if part == "centroids" else _first_pixels(f"{sog.where}: {name}", image, sog.count)

        longest_first = sorted(wanted, key=lambda part: -len(data[wanted[part][0]]))
        for part, found in zip(longest_first, pool.map(decoded, longest_first), strict=True):
            pixels[part] = found
            advance(1)
    palette = pixels.pop("centroids", None)
    return pixels, palette


def _palette(sog: _Meta, image: Array) -> tuple[int, Array]:
    """Degree of the harmonics, and the codes "p 3K" of the palette that the labels point into."""
    height, width = image.shape[:2]
    degree = _degree(sog, width)
    count = height * 64 if sog.rest_count is None else sog.rest_count
    if count > min(height * 64, _PALETTE_MAX) and sog.rest_count is not None:
        raise FormatError(
            f"{sog.where}: shN.count: found {count}, wanted at most the {height * 64} entries of its picture"
        )
    return degree, image.reshape(height * 64, -1)[:count]


def _degree(sog: _Meta, width: int) -> int:
    """Degree of the harmonics of a palette whose picture has this width."""
    degree = sog.rest_degree or {64 * k: d for d, k in _NUM_REST.items()}.get(width, 0)
    if degree == 0 or width != 64 * _NUM_REST[degree]:
        raise FormatError(
            f"{sog.where}: {sog.files['shN'][0]}: found {width} px across, wanted 64 entries of 3, 8 or 15 px "
            f"{f'({64 * _NUM_REST[degree]} px at {degree} bands) ' if degree else ''}for the palette of harmonics"
        )
    return degree


def _image(where: str, data: bytes) -> Array:
    """Decode a picture to "h w c" uint8, c = 3 or 4."""
    return _picture(
        where, data, lambda image: np.asarray(image if image.mode in ("RGB", "RGBA") else image.convert("RGBA"))
    )


def _picture(where: str, data: bytes, use: "Callable[[Image], T]") -> T:
    """What ``use`` makes of an opened picture, of which only the head has been read."""
    from PIL import Image, PngImagePlugin, WebPImagePlugin

    # Not Image.open, which loads the readers of all formats first.
    plugin = PngImagePlugin.PngImageFile if data[:4] == b"\x89PNG" else WebPImagePlugin.WebPImageFile
    try:
        with plugin(BytesIO(data)) as image:
            if image.width * image.height > max(4 * _GAUSSIANS_ALWAYS, 2 * _GAUSSIANS_PER_BYTE * len(data)):
                raise FormatError(
                    f"{where}: found a picture of {image.width} × {image.height} px in {len(data)} bytes: "
                    "its header is wrong or it is a decompression bomb"
                )
            return use(image)
    except FormatError:
        raise
    except (
        OSError,
        SyntaxError,
        ValueError,
        EOFError,
        RuntimeError,
        MemoryError,
        Image.DecompressionBombError,
    ) as error:
        raise FormatError(f"{where}: not a whole WebP picture ({error}); the file is damaged") from error


def _first_pixels(where: str, image: Array, count: int) -> Array:
    """The first ``count`` pixels, row by row."""
    height, width, channels = image.shape
    if height * width < count:
        raise FormatError(f"{where}: found {width} × {height} px, wanted at least {count} for as many Gaussians")
    return image.reshape(-1, channels)[:count]


def _with_channels(image: Array, channels: int) -> Array:
    """Three or four channels: WebP drops an alpha that is 255 everywhere, other writers keep one that stands for nothing."""
    found = image.shape[2]
    if found > channels:
        return np.ascontiguousarray(image[..., :channels])
    return image if found == channels else np.pad(image, ((0, 0), (0, 0), (0, 1)), constant_values=255)


def _folder_file(folder: Path, name: str) -> bytes:
    path = untrusted.inner_file(folder, name, "meta.json")
    try:
        return path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror}); meta.json names it") from error


def _meta_in(bundle: "zipfile.ZipFile") -> str | None:
    """The name of the meta.json of a bundle: at its top, or where a folder was packed as a whole, in the one that is there."""
    names = [name for name in bundle.namelist() if name.split("/")[-1] == "meta.json"]
    return "meta.json" if "meta.json" in names else names[0] if len(names) == 1 and names[0].count("/") == 1 else None


def _zip_entry(path: Path, bundle: "zipfile.ZipFile", name: str) -> bytes:
    import zlib

    try:
        entry = bundle.getinfo(name)
    except KeyError as error:
        raise FormatError(f"{path}: found no entry {name!r} in the bundle, only {bundle.namelist()[:12]}") from error
    if entry.file_size > _INFLATION_MAX * path.stat().st_size:
        raise FormatError(
            f"{path}: entry {name!r} promises {entry.file_size} bytes from a bundle of {path.stat().st_size}"
        )
    try:
        return bundle.read(entry)
    except (RuntimeError, OSError, zlib.error) as error:
        raise FormatError(f"{path}: entry {name!r} cannot be read ({error})") from error
