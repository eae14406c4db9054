"""Viewers of others, from npm, at the versions that the pages of `splatree serve` name."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from splatree.stream.pages import PACKAGES


def install(folder: Path, wanted: Mapping[str, str] = PACKAGES) -> tuple[Path | None, str]:
    """A folder node_modules with the viewers, or the reason why there is none; SPLATREE_NODE_MODULES names one that exists."""
    given = os.environ.get("SPLATREE_NODE_MODULES")
    if given and wanted is PACKAGES:
        return Path(given), ""
    npm = shutil.which("npm")
    if npm is None:
        return None, "the viewers of others come from npm, which is not installed"
    packages = [f"{name}@{version}" for name, version in wanted.items()]
    words = [npm, "install", "--ignore-scripts", "--no-audit", "--no-fund", "--prefix", str(folder), *packages]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600)
    if done.returncode:
        return None, f"npm could not install the viewers of others: {done.stderr.strip().splitlines()[-1:]}"
    return folder / "node_modules", ""
