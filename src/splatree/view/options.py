"""How a scene is shown: defaults live here alone; the command line's help is these docstrings."""

import re
from dataclasses import dataclass

import numpy as np

from splatree.constants import PIXEL_ERROR
from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.scene.literals import check_literals
from splatree.scene.options import SelectOptions
from splatree.stream.http import LOOPBACK

_ORIGIN = re.compile(r"[a-z][a-z0-9+.\-]*://[^/\s;,'\"]+")
"""What a browser says of where a page comes from."""

CAPACITY = 1 << 21
"""Nodes that a page holds at most: 64 MiB of graphics memory at 32 bytes a node."""

LEAST_QUALITY_DB, MOST_QUALITY_DB = 20, 60
"""Qualities that a page may ask for: worse is of no use, better is not seen."""


@dataclass(frozen=True)
class ViewOptions:
    """Where and how a scene is shown.

    Example:
        >>> st.ViewOptions(budget=100_000).is_local
        True
    """

    port: int = 0
    """Port to listen on; 0: any port that is free."""
    host: str = "127.0.0.1"
    """Address to listen on. Any address but this machine's own needs the token that is part of the printed address."""
    budget: int = 300_000
    """Largest number of nodes drawn; a slider of the page changes it."""
    pixel_error: float = PIXEL_ERROR
    """τ_R, px: a node stands for its subtree if its radius on the screen is at most this; a slider of the page changes it."""
    quality: float | None = None
    """PSNR against all leaves that each view shall have, dB, in place of a pixel error; a slider of the page changes it. It is
    measured where the camera has moved by a tenth of the distance. The budget goes before it. None: by pixel_error."""
    occlusion: bool = False
    """Draw with fewer nodes what nearer Gaussians hide: near views of as many nodes come 1 to 10 dB nearer to all leaves. A view
    takes 20 to 105 CPU-milliseconds more; a box of the page changes it. Not for scenes that are read page by page."""
    device: DeviceName = "cpu"
    """Where the nodes are chosen and exact pictures drawn: `cuda` is an NVIDIA GPU."""
    up: tuple[float, float, float] | None = None
    """Direction that is up in the scene; None: it is guessed."""
    frames: bool = False
    """Draw on the server only and send pictures, as for browsers without WebGL2."""
    allow_origin: tuple[str, ...] = ()
    """Other addresses whose pages may embed the viewer and talk to it, such as https://hub.example of a notebook server."""

    def __post_init__(self) -> None:
        check_literals(self)
        if not 0 <= self.port <= 65535:
            raise InputError(f"port: found {self.port}, wanted 0 to 65535")
        if not 1_000 <= self.budget <= CAPACITY:
            raise InputError(f"budget: found {self.budget:,} nodes, wanted 1,000 to {CAPACITY:,}")
        if not 0 <= self.pixel_error <= 1e4:
            raise InputError(f"pixel_error: found {self.pixel_error}, wanted 0 to 10000 px")
        if self.up is not None and not 0 < np.linalg.norm(self.up) < np.inf:
            raise InputError(f"up: found {self.up}, wanted a direction")
        if self.quality is not None:
            SelectOptions(self.pixel_error, quality=self.quality)  # refuses what contradicts itself
            if not LEAST_QUALITY_DB <= self.quality <= MOST_QUALITY_DB:
                raise InputError(
                    f"quality: found {self.quality:g} dB, wanted {LEAST_QUALITY_DB} to {MOST_QUALITY_DB} dB in the viewer"
                )
        for origin in self.allow_origin:
            if not _ORIGIN.fullmatch(origin):
                raise InputError(
                    f"allow_origin: found {origin!r}, wanted scheme, name and port without a path, such as https://hub.example"
                )
        if not self.host:
            raise InputError("host: found nothing, wanted an address, such as 127.0.0.1")

    @property
    def is_local(self) -> bool:
        """Whether only this machine can connect."""
        return self.host in LOOPBACK
