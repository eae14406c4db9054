"""Draw the pictures of the README again: `python scripts/pictures.py [city]` (two minutes on two cores, 4 GB).

The scene is "KARANGKIDUL KOTA SEMARANG 2" by Samuel Hiero, CC BY 4.0, https://superspl.at/scene/b4b950fe: a folder of ten SOG
folders, by default ../shared/data/trained/semarang_city. Counts and PSNRs are printed and written into the pictures.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import splatree as st
from splatree.constants import SH_C0

ROOT = Path(__file__).parent.parent
CITY = ROOT.parent / "shared" / "data" / "trained" / "semarang_city"
IMAGES = ROOT / "docs" / "images"

SKY = st.RenderOptions(background=(0.80, 0.89, 0.96))
LEAVES = st.SelectOptions(pixel_error=0)
CUT = st.SelectOptions(pixel_error=3)

RAMP = np.array([(0.78, 0.80, 0.80), (0.98, 0.78, 0.16), (0.95, 0.42, 0.12), (0.80, 0.12, 0.40), (0.36, 0.14, 0.62)])
"""Colours of nodes that stand for 1, 2, 4, 8 and 16 or more leaves, RGB."""
RAMP_NAMES = ("1 leaf", "2", "4", "8", "16 leaves and more")

SLANT = 0.22
"""How far the lines between the parts of a picture lean, of its height."""


def main(city: Path) -> None:
    """Draw both pictures."""
    scene = st.read(sorted(str(folder) for folder in city.glob("5_*")))
    camera = st.Camera.look_at((60, -180, -420), (60, 18, -103), width=1600, height=800, fov_y_deg=40)
    draw_levels(st.build_lod(scene, st.BuildOptions(method="pairs")), camera, IMAGES / "city.jpg")
    draw_smaller(scene, IMAGES / "smaller.jpg")


def draw_levels(tree: st.Scene, camera: st.Camera, path: Path) -> None:
    """All leaves, the cut, and the cut in the colours of its levels, as three parts of one view."""
    leaves = st.trace(tree, camera, SKY, LEAVES)
    cut = st.trace(tree, camera, SKY, CUT)
    levels = st.render(with_level_colors(tree), camera, st.RenderOptions(background=(1.0, 1.0, 1.0)), CUT).image
    light = cut.result.image.mean(axis=2, keepdims=True)
    tinted = levels * (0.2 + 0.95 * light)
    decibels = st.psnr(cut.result.image.clip(0, 1), leaves.result.image.clip(0, 1))
    captions = (
        f"all leaves in view: {len(leaves.selection):,}",
        f"cut at 3 px: {len(cut.selection):,} nodes, {decibels:.1f} dB",
        "the same cut, coloured by level",
    )
    print(*captions, sep="\n")
    picture = side_by_side([leaves.result.image, cut.result.image, tinted], captions)
    draw_legend(picture)
    save(picture, path)


def draw_smaller(scene: st.Scene, path: Path) -> None:
    """A tower of the city whole, thinned to a quarter and to a tenth."""
    tower = st.edit(scene, st.EditOptions(crop_sphere=(75.0, 0.0, -260.0, 130.0)))
    camera = st.Camera.look_at((55, -205, -500), (75, -20, -260), width=1600, height=560, fov_y_deg=26)
    images, captions = [], []
    for keep in (1.0, 0.25, 0.1):
        small = tower
        if keep < 1:
            small = st.thin(tower, st.ThinOptions(keep=keep)).scene
        images.append(st.render(small, camera, SKY).image)
        decibels = "" if keep == 1 else f", {st.psnr(images[-1].clip(0, 1), images[0].clip(0, 1)):.1f} dB"
        captions.append(f"{len(small):,} Gaussians{decibels}")
    print(*captions, sep="\n")
    part = camera.width // 3
    middle = slice((camera.width - part) // 2, (camera.width - part) // 2 + part)
    picture = as_picture(np.concatenate([image[:, middle] for image in images], axis=1))
    for i, caption in enumerate(captions):
        draw_label(ImageDraw.Draw(picture), (i * part + 14, 12), caption)
    save(picture, path)


def with_level_colors(tree: st.Scene) -> st.Scene:
    """The scene with each node coloured by the number of leaves that it stands for."""
    before = np.concatenate([[0], np.cumsum(tree.tree.is_leaf)])
    num_leaves = before[tree.tree.subtree_end] - before[:-1]
    colors = RAMP[np.minimum(np.log2(num_leaves).round().astype(int), len(RAMP) - 1)]
    sh = ((colors - 0.5) / SH_C0).astype(np.float32)[:, None]
    return replace(tree, gaussians=replace(tree.gaussians, sh=np.ascontiguousarray(sh)))


def side_by_side(images: Sequence[np.ndarray], captions: Sequence[str]) -> Image.Image:
    """One view in slanted parts, each from another image, with a white line between them and a caption in each."""
    height, width = images[0].shape[:2]
    picture = as_picture(images[0])
    drawing = ImageDraw.Draw(picture)
    for i, image in enumerate(images[1:], 1):
        top, bottom = width * i / len(images) + SLANT * height / 2, width * i / len(images) - SLANT * height / 2
        mask = Image.new("L", picture.size)
        ImageDraw.Draw(mask).polygon([(top, 0), (width, 0), (width, height), (bottom, height)], fill=255)
        picture.paste(as_picture(image), mask=mask)
        drawing.line([(top, 0), (bottom, height)], fill="white", width=5)
    for i, caption in enumerate(captions):
        draw_label(drawing, (width * i / len(images) + (SLANT * height / 2 if i else 0) + 18, 16), caption)
    return picture


def draw_legend(picture: Image.Image) -> None:
    """The colours of the ramp in the lower right corner."""
    drawing = ImageDraw.Draw(picture)
    font = ImageFont.load_default(20)
    wide = [44 + int(drawing.textlength(name, font=font)) for name in RAMP_NAMES]
    x, y = picture.width - sum(wide) - 4, picture.height - 46
    drawing.rounded_rectangle([x - 14, y - 8, picture.width - 12, picture.height - 12], 8, fill="#202428")
    for color, name, step in zip(RAMP, RAMP_NAMES, wide, strict=True):
        drawing.rectangle([x, y + 3, x + 22, y + 25], fill=tuple(int(255 * channel) for channel in color))
        drawing.text((x + 30, y + 1), name, fill="white", font=font)
        x += step


def draw_label(drawing: ImageDraw.ImageDraw, place: tuple[float, float], text: str) -> None:
    """White text on a dark plate."""
    font = ImageFont.load_default(22)
    x, y = place
    drawing.rounded_rectangle([x - 8, y - 5, x + drawing.textlength(text, font=font) + 8, y + 31], 8, fill="#202428")
    drawing.text((x, y), text, fill="white", font=font)


def as_picture(image: np.ndarray) -> Image.Image:
    """8-bit picture of a float image."""
    return Image.fromarray((image.clip(0, 1) * 255 + 0.5).astype(np.uint8))


def save(picture: Image.Image, path: Path) -> None:
    """Write a JPEG of at most 600 KB."""
    for quality in range(92, 40, -4):
        picture.save(path, quality=quality, optimize=True, progressive=True)
        if path.stat().st_size <= 600_000:
            print(f"{path}: {path.stat().st_size:,} bytes at quality {quality}")
            return


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else CITY)
