"""The launches of a frame, stage by stage: which kernel, how many thread blocks, which number.

Grids cover what the arrays hold, not what a view needs: kernels read how much there is from counters on the device and
the rest of their thread blocks end at once. So nothing has to be asked in between, and a frame can be recorded once and replayed.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from splatree.scene.view import Wanted

__all__ = [
    *("SCAN_CHUNK", "SORT_TILE", "Blend", "Launch", "Sizes"),
    *("bin_pairs", "blend", "blend_backward", "order", "project", "project_backward", "select", "splat_bits"),
]

Blend = Literal["blend_16", "blend_8", "blend_8x4", "longest_16", "longest_8", "longest_8x4"]
"""The kernels that blend (blend.cu), each also with the longest lists of tiles first."""

SORT_TILE = SCAN_CHUNK = 4096
"""Keys of a tile of the sort, values of a chunk of a scan (order.cu, scan.h)."""
SCAN_THREADS = 256
"""Threads of a thread block of a scan; `list_pairs` takes a splat each."""
NOTHING = Wanted()
"""No output beside colour, alpha and depth."""
DIGITS, DIGIT_BITS, DEPTH_BITS = 256, 8, 32
SPLATS_SUMMED = 16
"""Splats of a thread block of `sum_splats` (blend_backward.cu)."""
MAX_PASSES = 4
"""Most passes of a sort."""
PAIR_SCAN, NUM_SCANS = 1, 2
"""Places of a frame's scans: that of the selection is 0."""
NUM_PASSES = 2 * MAX_PASSES
"""Of the sort of the splats and of that of the pairs."""


class Launch(NamedTuple):
    """One kernel."""

    kernel: str
    """Its name."""
    num_thread_blocks: int
    """Thread blocks of the grid."""
    argument: int = 0
    """What it takes beside the job."""


@dataclass(frozen=True)
class Sizes:
    """What a frame's arrays hold."""

    num_blocks: int
    """Blocks of the scene's index."""
    rows: int
    """Rows that can be selected."""
    pairs: int
    """Pairs of splat and tile."""
    num_tiles: int
    """Tiles of the image."""
    has_ids: bool
    """Whether rows have ids; else they are their own."""
    tapers: bool
    """Whether splats are tapered off."""
    num_multiprocessors: int
    """Of the device."""

    @property
    def has_short_keys(self) -> bool:
        """Whether the number of a tile has no more than 16 bits."""
        return self.num_tiles <= 1 << 16

    @property
    def chain_stride(self) -> int:
        """Chunks of the longest scan."""
        return max(_over(self.num_blocks, SCAN_CHUNK), _over(self.rows, SCAN_THREADS))

    @property
    def num_swept(self) -> int:
        """Words by which the tiles of the sorts of a frame look back."""
        return self.num_swept_by(_tile_bits(self))

    def num_swept_by(self, pair_bits: int) -> int:
        """The same if pairs are sorted by so many bits."""
        of_pairs = _over(pair_bits, DIGIT_BITS) * _over(self.pairs, SORT_TILE)
        return DIGITS * (MAX_PASSES * _over(self.rows, SORT_TILE) + of_pairs)


def select(sizes: Sizes) -> list[Launch]:
    """The visible cut as ascending rows."""
    warps = _over(sizes.num_blocks, 8)
    return [
        Launch("select_blocks", warps),
        Launch("select_rows", min(sizes.num_blocks, 8 * sizes.num_multiprocessors)),
        Launch("scan_kept", _over(sizes.num_blocks, SCAN_CHUNK)),
        Launch("list_rows", warps),
    ]


def project(sizes: Sizes) -> list[Launch]:
    """Splats of the rows."""
    return [Launch("project", _over(sizes.rows, 128))]


def order(sizes: Sizes) -> list[Launch]:
    """Splats by depth, equal depths by id."""
    threads = _over(sizes.rows, 256)
    assert not _side_after(DEPTH_BITS), "keep_order reads side a"
    return [
        Launch("order_splats", threads),
        *_sort(sizes.rows, DEPTH_BITS, pairs=False),
        Launch("keep_order", threads, int(sizes.has_ids)),
    ]


def bin_pairs(sizes: Sizes) -> list[Launch]:
    """The lists of the tiles."""
    short = sizes.has_short_keys
    return [
        Launch("list_pairs", _over(sizes.rows, SCAN_THREADS), sizes.tapers | short << 1 | PAIR_SCAN << 2),
        *_sort(sizes.pairs, _tile_bits(sizes), pairs=True, short=short),
        Launch("start_tiles", _over(sizes.num_tiles + 1, 256), pair_side(sizes) | short << 1),
    ]


def blend(sizes: Sizes, kernel: Blend, wanted: Wanted = NOTHING) -> list[Launch]:
    """The picture; with what else is wanted by kernels of a thread block a tile."""
    order, part = kernel.split("_")
    blocks_per_tile = {"16": 1, "8": 4, "8x4": 8}[part]
    name = f"taper_{part}" if sizes.tapers else f"blend_{part}"
    if wanted != NOTHING:
        kept = "pixels" if not wanted.contributions else "both" if wanted.of_pixels else "pairs"
        blocks_per_tile, name = 1, f"{kept}_taper_16" if sizes.tapers else f"{kept}_16"
    longest_first = order == "longest"
    drawing = Launch(name, sizes.num_tiles * blocks_per_tile, pair_side(sizes) | longest_first << 1)
    return [Launch("order_tiles", 1), drawing] if longest_first else [drawing]


def blend_backward(sizes: Sizes) -> list[Launch]:
    """The sums of each splat over its pixels; pairs are then sorted by splat, so their lists are gone."""
    side, bits = pair_side(sizes), splat_bits(sizes)
    return [
        Launch("blend_backward", sizes.num_tiles, side),
        Launch("key_by_splat", _over(sizes.pairs, 256), side),
        *_sort(sizes.pairs, bits, pairs=True),
        Launch("sum_splats", _over(sizes.rows, SPLATS_SUMMED), _side_after(bits)),
    ]


def project_backward(sizes: Sizes) -> list[Launch]:
    """Derivatives by the rows of the splats."""
    return [Launch("project_backward", _over(sizes.rows, 128))]


def pair_side(sizes: Sizes) -> int:
    """Whether the sorted pairs are on side b."""
    return _side_after(_tile_bits(sizes))


def splat_bits(sizes: Sizes) -> int:
    """Bits of the number of a splat."""
    return max(sizes.rows - 1, 0).bit_length()


def _tile_bits(sizes: Sizes) -> int:
    return (sizes.num_tiles - 1).bit_length()


def _sort(capacity: int, num_bits: int, *, pairs: bool, short: bool = False) -> list[Launch]:
    """A sort by the lowest bits of the keys, which begins on side a."""
    tiles, num_passes, bits = _over(capacity, SORT_TILE), _over(num_bits, DIGIT_BITS), "_16" if short else ""
    # A launch has one number beside the job, and these kernels need more. The number is packed here and unpacked by `pass_of` in
    # order.cu, because a frame's launches are recorded once and replayed, so the job cannot change between them.
    common = pairs << 5 | num_passes << 7
    passes = [Launch(f"move_digits{bits}", tiles, DIGIT_BITS * i | i % 2 << 6 | common) for i in range(num_passes)]
    return [Launch(f"count_digits{bits}", tiles, common), *passes] if passes else []


def _side_after(num_bits: int) -> int:
    return _over(num_bits, DIGIT_BITS) % 2


def _over(count: int, size: int) -> int:
    return -(-count // size)
