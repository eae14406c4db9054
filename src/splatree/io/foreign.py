"""Files that people have but that are not read, and what to do with them."""

from pathlib import Path

__all__ = ["advice"]

_PICKLES = (".pth", ".pt", ".ckpt", ".pkl", ".pickle")
_PICKLE_PROTOCOLS = tuple(bytes([0x80, protocol]) for protocol in range(2, 6))


def advice(path: Path, head: bytes) -> str | None:
    """What a file of a kind that is known but not read is, and how to export a scene from it; None for other files."""
    if path.suffix.lower() in _PICKLES or head.startswith(_PICKLE_PROTOCOLS) or _is_checkpoint(head):
        return (
            "is a pickled checkpoint (3DGS, gsplat, LoG, FilterGS, Octree-GS), which could run any code when it is loaded and so "
            "is never opened here; export a .ply with the program that trained it (3DGS has one beside it, in point_cloud/), or "
            "load it where you trust it and hand its tensors to splatree.Gaussians"
        )
    return None


def _is_checkpoint(head: bytes) -> bool:
    """Whether it is a ZIP as torch.save writes it: its first entry is NAME/data.pkl."""
    return head[:4] == b"PK\x03\x04" and head[30 : 30 + 256].partition(b"\x80")[0].find(b"/data.pkl") >= 0
