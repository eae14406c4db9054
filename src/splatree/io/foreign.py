"""Files that people have but that are not read, and what to do with them."""

import re
from pathlib import Path

__all__ = ["advice", "advice_for_folder", "not_content", "packed"]

_PICKLES = (".pth", ".pt", ".ckpt", ".pkl", ".pickle")
_PICKLE_PROTOCOLS = tuple(bytes([0x80, protocol]) for protocol in range(2, 6))


_ARCHIVES = {
    b"BZh91AY&SY": ("bzip2", "bunzip2"),
    b"\xfd7zXZ\0": ("xz", "unxz"),
    b"\x28\xb5\x2f\xfd": ("zstd", "unzstd"),
    b"7z\xbc\xaf\x27\x1c": ("7z", "7z x"),
    b"Rar!\x1a\x07": ("RAR", "unrar x"),
}
"""First bytes of files that other programs unpack: what they are called, and the program."""

_PICTURES = (b"\x89PNG\r\n", b"\xff\xd8\xff", b"II*\0", b"MM\0*")
_PICTURE_BRANDS = (b"WEBP", b"heic", b"heix", b"mif1", b"avif")
_PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic")
_SURVEYED = (".las", ".laz", ".e57", ".xyz", ".pts", ".obj", ".stl", ".fbx", ".dae", ".usdz")
_OF_PHOTOGRAPHS = {"images", "sparse", "transforms.json", "images.bin", "images.txt"}
_OTHERS = {
    ".lcc": "is a scene of XGRIDS (LCC), which is not read; `splat-transform scene.lcc scene.ply` converts it",
    ".splatv": "is a moving scene of antimatter15's viewer, which is not read: splatree draws what stands still",
}
_TRAIN = "train a scene from photographs whose cameras are known: splatree train FOLDER -o scene.splatree"


def not_content(head: bytes) -> str | None:
    """What a file is that a download left in the place of its content; None for other files. ``head`` is its first bytes."""
    if not head:
        return "is empty: found 0 bytes; a download or a copy was cut off, fetch it again"
    if head.startswith(b"version https://git-lfs.github.com/spec/"):
        number = re.search(rb"\nsize (\d{1,18})\s", head)
        size = f" for {int(number[1]) / 2**20:,.1f} MiB" if number else ""
        return f"is a Git LFS pointer{size}, not the file itself; fetch it with `git lfs pull`"
    start = head[:512].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if start.startswith((b"<!doctype html", b"<html", b"<head", b"<?xml")):
        title = re.search(rb"<title>([^<]{1,80})</title>", head, re.IGNORECASE)
        words = f" ({title[1].decode('utf-8', 'replace').strip()!r})" if title else ""
        return f"is a web page{words}: the server answered with it in place of the file; fetch it again"
    return None


def packed(head: bytes) -> str | None:
    """What a file is that was compressed and kept its name; None for other files. In a .splat such an x is below 1e-19."""
    if head.startswith(b"\x1f\x8b\x08") and head[3:4] < b"\x20":
        return "is compressed by gzip, which its name does not say; add .gz to its name, or unpack it with `gunzip`"
    if head.startswith(b"PK\x03\x04"):
        return "is a ZIP, which its name does not say; let its name end in .zip, or unpack it"
    for magic, (kind, command) in _ARCHIVES.items():
        if head.startswith(magic):
            return f"is packed as {kind}, which is not read; unpack it with `{command}`"
    if head[257:262] == b"ustar":
        return "is a tar archive, which is not read; unpack it with `tar -xf`"
    return None


def advice(path: Path, head: bytes) -> str | None:
    """What a file of a kind that is known but not read is, and how to export a scene from it; None for other files."""
    if content := not_content(head):
        return content
    if path.suffix.lower() in _PICKLES or head.startswith(_PICKLE_PROTOCOLS) or _is_checkpoint(head):
        return (
            "is a pickled checkpoint (3DGS, gsplat, LoG, FilterGS, Octree-GS), which could run any code when it is loaded and so "
            "is never opened here; export a .ply with the program that trained it (3DGS has one beside it, in point_cloud/), or "
            "load it where you trust it and hand its tensors to splatree.Gaussians"
        )
    if head.startswith(_PICTURES) or head[8:12] in _PICTURE_BRANDS:
        return f"is a picture, not a scene; {_TRAIN}"
    if head[4:8] == b"ftyp" or head[8:12] == b"AVI " or head.startswith(b"\x1a\x45\xdf\xa3"):
        return f"is a video, not a scene; take pictures out of it, find their cameras with COLMAP, and {_TRAIN}"
    if archive := packed(head):
        return archive
    if path.suffix.lower() in _OTHERS:
        return _OTHERS[path.suffix.lower()]
    if path.suffix.lower() in _SURVEYED:
        return f"is a point cloud or a mesh, which holds no Gaussians; {_TRAIN}"
    return None


def advice_for_folder(folder: Path) -> str | None:
    """What a folder without a scene is, if it is one that people have; None for other folders."""
    names = [entry.name.lower() for entry in folder.iterdir()]
    if any(name.endswith(".lcc") for name in names):
        return _OTHERS[".lcc"]
    if any(name.endswith(_PICTURE_SUFFIXES) for name in names) or _OF_PHOTOGRAPHS & set(names):
        return f"holds photographs or their cameras, not a scene; {_TRAIN}"
    return None


def _is_checkpoint(head: bytes) -> bool:
    """Whether it is a ZIP as torch.save writes it: its first entry is NAME/data.pkl."""
    return head[:4] == b"PK\x03\x04" and head[30 : 30 + 256].partition(b"\x80")[0].find(b"/data.pkl") >= 0
