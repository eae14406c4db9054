"""What pictures are compared with: photographs at whole divisions, as 8-bit pixels, and the cameras that belong to them.

A photograph at a division of k is cropped at its right and lower border to a multiple of k; each pixel is then the mean of k × k
pixels, and the intrinsics are divided by k exactly. Photographs of different views are held apart here: `Targets` opens the
training photographs alone. It never knows the paths of held-out ones.

Memory: pixels are kept once they were asked for, up to `KEPT_BYTES`; beyond that a photograph is decoded each time.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatree.errors import InputError
from splatree.io.photos import Photos, PhotosUsed
from splatree.progress import track
from splatree.scene.cameras import Camera
from splatree.shapes import Array, Bool, Float64, UInt8, check_fields
from splatree.train.options import Alpha

__all__ = ["LONGEST_PX", "Target", "Targets", "divided"]

KEPT_BYTES = 2 << 30
"""Memory for decoded photographs."""

LONGEST_PX = 1000
"""Photographs are compared at the largest division whose longer side has at most this many pixels, unless told otherwise."""

SHORTEST_PX = 96
"""Divisions that leave fewer pixels along the shorter side show too little to begin with."""

_MASK_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True, eq=False)
class Target:
    """A photograph and its camera, at one size."""

    camera: Camera
    """The view, as large as the photograph."""
    photo: UInt8[Array, "h w 3"]
    """RGB, 0 to 255."""
    mask: Bool[Array, "h w"] | None
    """Pixels that count; None: all."""
    opacity: UInt8[Array, "h w"] | None = None
    """Alpha of the photograph, whose colours are then those over black, 0 to 255; None: it is not matched."""

    def __post_init__(self) -> None:
        check_fields(self, h=self.camera.height, w=self.camera.width)

    @property
    def num_bytes(self) -> int:
        """Memory of the pixels."""
        return sum(plane.nbytes for plane in (self.photo, self.mask, self.opacity) if plane is not None)


class Targets:
    """Photographs of views at all sizes.

    Raises:
        InputError: no photograph is found, the folder of the masks is none, or a mask has another shape than its photograph.
        FormatError: a photograph is damaged; told when it is decoded.
    """

    def __init__(
        self, folder: Path, cameras: Sequence[Camera], *, masks: Path | None = None, alpha: Alpha = "mask"
    ) -> None:
        self._photos = Photos(folder, cameras)
        self.cameras = tuple(view for view in self._photos.views if view.name in self._photos)
        self._masks = {} if masks is None else _masks_of(masks, [camera.name for camera in self.cameras])
        for name, mask in self._masks.items():
            self._photos.check_mask(name, mask)
        self._matches_alpha = alpha == "match"
        self._kept: dict[tuple[int, int], Target] = {}
        self._num_bytes = 0

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def num_masks(self) -> int:
        """How many photographs have a mask."""
        return len(self._masks)

    @property
    def used(self) -> PhotosUsed:
        """Which photographs were found."""
        return self._photos.used

    def placed(self, near: float, origin: Float64[Array, "3"]) -> None:
        """Move the views to a world with another zero, and let them see things from ``near`` on."""
        self.cameras = tuple(replace(camera.moved(origin), near=near) for camera in self.cameras)
        self._kept.clear()
        self._num_bytes = 0

    def at(self, i: int, division: int) -> Target:
        """The i-th photograph at a division."""
        if (i, division) not in self._kept:
            target = self._decoded(i, division)
            num_bytes = target.num_bytes
            if self._num_bytes + num_bytes > KEPT_BYTES:
                self.drop_others(division)
            if self._num_bytes + num_bytes > KEPT_BYTES:
                return target
            self._kept[i, division] = target
            self._num_bytes += num_bytes
        return self._kept[i, division]

    def read_all(self, division: int) -> None:
        """Read all photographs at a division, so that a damaged one is told now; as many as there is room for are kept.

        Raises:
            FormatError: one is damaged.
        """
        for i in track(range(len(self)), "read photographs"):
            self.at(i, division)

    def check_pixels(self, division: int) -> None:
        """Refuse photographs of which no pixel counts; they are decoded up to the first that has one.

        Raises:
            InputError: none of them has.
        """
        for i in range(len(self)):
            mask = self.at(i, division).mask
            if mask is None or mask.any():
                return
        wanted = (
            "masks: found no pixel that counts in {}, wanted some that are white; masks of 0 and 1 have to be multiplied by 255"
            if self._masks
            else "photos: found no pixel that counts in {}, wanted some whose alpha is opaque"
        )
        raise InputError(wanted.format(f"the {len(self)} photographs"))

    def drop_others(self, division: int) -> None:
        """Forget the photographs at other divisions."""
        self._kept = {key: target for key, target in self._kept.items() if key[1] == division}
        self._num_bytes = sum(target.num_bytes for target in self._kept.values())

    def digests(self) -> dict[str, str]:
        """A digest of the file of each photograph, by name."""
        found = {}
        for camera in self.cameras:
            with self._photos.path_of(camera.name).open("rb") as file:
                found[camera.name] = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
        return found

    def _decoded(self, i: int, division: int) -> Target:
        from PIL import Image

        name = self.cameras[i].name
        camera = divided(self.cameras[i], division)
        box = (0, 0, camera.width * division, camera.height * division)
        pixels, opacity = self._photos.pixels(name), self._photos.opacity(name) if self._matches_alpha else None
        if opacity is not None:
            pixels = np.rint(pixels * (opacity[..., None] / np.float32(255))).astype(np.uint8)

        def small(plane: Array) -> Array:
            whole = Image.fromarray(plane)
            return np.array(whole.reduce(division, box) if division > 1 else whole)

        photo, opacity = small(pixels), None if opacity is None else small(opacity)
        counts = self._photos.counting(name, self._masks.get(name), alpha=not self._matches_alpha)
        if counts is not None:  # a pixel counts if all count that it is the mean of
            blocks = counts[: box[3], : box[2]].reshape(camera.height, division, camera.width, division)
            counts = np.ascontiguousarray(blocks.all(axis=(1, 3)))
        return Target(camera, photo, counts, opacity)


def divided(camera: Camera, division: int) -> Camera:
    """A view with ``division`` times fewer pixels along each side; what is left over at the right and below is cut off."""
    K = camera.K.copy()
    K[:2] /= division
    return replace(camera, K=K, width=camera.width // division, height=camera.height // division)


def finest_division(cameras: Sequence[Camera], longest_px: int = LONGEST_PX) -> int:
    """The division at which all photographs are at most ``longest_px`` long; 8 if none is."""
    longest = max(max(camera.width, camera.height) for camera in cameras)
    return next((k for k in (1, 2, 4) if longest // k <= longest_px), 8)


def coarsest_division(cameras: Sequence[Camera]) -> int:
    """The largest division that leaves each photograph `SHORTEST_PX` along its shorter side; 1 if none does."""
    shortest = min(min(camera.width, camera.height) for camera in cameras)
    return next((k for k in (8, 4, 2) if shortest // k >= SHORTEST_PX), 1)


def _masks_of(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    if not folder.is_dir():
        raise InputError(f"masks: {folder} is not a folder; wanted one with masks by the names of the photographs")
    found: dict[str, Path] = {}
    for name in names:
        plain = Path(name.replace("\\", "/"))
        stems = (plain, plain.with_suffix(""), Path(plain.name), Path(plain.stem))
        candidates = (folder / f"{stem}{suffix}" for stem in stems for suffix in ("", *_MASK_SUFFIXES))
        mask = next((path for path in candidates if path.is_file()), None)
        if mask is not None:
            found[name] = mask
    return found
