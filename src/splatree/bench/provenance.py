"""What a number was measured with: processor, instruction set, threads, version, commit."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from splatree.kernels.cpu import _core

__all__ = ["machine", "program"]


def machine() -> str:
    """Processor, threads and instruction set in use."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text("utf-8").splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    return f"{name}, {_core.hardware_threads()} threads, instruction set {_core.isa()}, {platform.system()}"


def program() -> str:
    """Version of splatree, and the commit if it runs from a checkout of its repository."""
    try:
        named = f"splatree {version('splatree')}"
    except PackageNotFoundError:
        named = "splatree of a source tree"
    root = Path(__file__).resolve().parents[3]
    if not (root / "src" / "splatree").is_dir() or not (root / ".git").exists():
        return named
    try:
        words = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude", "*"]
        commit = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return named
    return f"{named}, commit {commit}"
