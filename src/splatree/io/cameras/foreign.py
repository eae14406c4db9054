"""Files of cameras that people have but that are not read, and how to get one that is."""

from pathlib import Path
from typing import Any

__all__ = ["advice_for_content", "advice_for_file"]

_AS_COLMAP = "wanted a COLMAP model, transforms.json or cameras.json"


def advice_for_file(path: Path) -> str | None:
    """What a file or folder of cameras is by its name and first bytes, and what to do; None for those read or unknown."""
    if path.is_dir():
        if (path / "keyframes").is_dir():
            return f"is a capture of Polycam, {_AS_COLMAP}: `ns-process-data polycam` makes transforms.json of it"
        if (path / "reconstruction.json").is_file():
            return f"holds a reconstruction of OpenSfM, {_AS_COLMAP}: `opensfm export_colmap`, or `ns-process-data odm`"
        return None
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(4096).lower()
    if suffix == ".xml" and (b"<chunk" in head or b"agisoft" in head or b"<document" in head):
        return (
            f"is the cameras of Metashape, {_AS_COLMAP}: export them as COLMAP (File, Export, Export Cameras), or use "
            "`ns-process-data metashape`"
        )
    if suffix == ".xml" and b"<blocksexchange" in head:
        return f"is a BlocksExchange of ContextCapture, {_AS_COLMAP}: export the cameras as COLMAP there, or through Metashape"
    if suffix == ".csv" and b"name" in head and (b"heading" in head or b"alt" in head):
        return (
            f"is the cameras of RealityCapture, {_AS_COLMAP}: export them as COLMAP (Alignment, Export, Registration), or use "
            "`ns-process-data realitycapture`"
        )
    if suffix == ".out" and b"bundle file" in head:
        return f"is a model of Bundler, {_AS_COLMAP}: `colmap model_converter` and Metashape read it"
    if suffix == ".nvm" or head.startswith(b"nvm_v3"):
        return f"is a model of VisualSFM, {_AS_COLMAP}: `colmap model_converter` reads it"
    return None


def advice_for_content(content: Any) -> str | None:
    """The same of parsed JSON."""
    first = content[0] if isinstance(content, list) and content else content
    if not isinstance(first, dict):
        return None
    if "shots" in first and "cameras" in first:
        return f"is a reconstruction of OpenSfM, {_AS_COLMAP}: `opensfm export_colmap`, or `ns-process-data odm`"
    if "t_00" in first and "t_23" in first:
        return f"is a camera of Polycam, {_AS_COLMAP}: `ns-process-data polycam` makes transforms.json of the whole capture"
    if "views" in first and ("poses" in first or "intrinsics" in first):
        return f"is a model of Meshroom or OpenMVG, {_AS_COLMAP}: both export COLMAP"
    if "poses" in first and "K" in first:
        return f"is a capture of Record3D, {_AS_COLMAP}: `ns-process-data record3d` makes transforms.json of it"
    return None
