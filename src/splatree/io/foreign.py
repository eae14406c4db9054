"""Files that people have but that are not read, and what to do with them."""

import re
from pathlib import Path

__all__ = ["advice", "advice_for_folder", "not_content", "packed"]

_PICKLES = (".pth", ".pt", ".ckpt", ".pkl", ".pickle")
_PICKLE_PROTOCOLS = tuple(bytes([0x80, protocol]) for protocol in range(2, 6))


_PICTURES = (b"\x89PNG\r\n", b"\xff\xd8\xff", b"II*\0", b"MM\0*")
_PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic")
_SURVEYED = (".las", ".laz", ".e57", ".xyz", ".pts", ".obj", ".stl", ".fbx", ".dae", ".usdz")
_OF_PHOTOGRAPHS = {"images", "sparse", "transforms.json", "images.bin", "images.txt"}
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
    if head.startswith(_PICTURES):
        return f"is a picture, not a scene; {_TRAIN}"
    if path.suffix.lower() in _SURVEYED:
        return f"is a point cloud or a mesh, which holds no Gaussians; {_TRAIN}"
    return None


def advice_for_folder(folder: Path) -> str | None:
    """What a folder without a scene is, if it is one of photographs or their cameras; None for other folders."""
    names = [entry.name.lower() for entry in folder.iterdir()]
    if any(name.endswith(_PICTURE_SUFFIXES) for name in names) or _OF_PHOTOGRAPHS & set(names):
        return f"holds photographs or their cameras, not a scene; {_TRAIN}"
    return None


def _is_checkpoint(head: bytes) -> bool:
    """Whether it is a ZIP as torch.save writes it: its first entry is NAME/data.pkl."""
    return head[:4] == b"PK\x03\x04" and head[30 : 30 + 256].partition(b"\x80")[0].find(b"/data.pkl") >= 0
