"""What a program computes of fixed numbers.

Parts of one scene fit together only if all of them decide alike to the last bit. exp and log may differ in it between
processors and libraries, and what a merge changes in the last bits between instruction sets, which seldom shows in a small tree.
So each process computes the same small builds and costs, and takes part only if its bits are those of the plan.
"""

import hashlib
from functools import cache

import numpy as np

from splatree.kernels.cpu.build.pairs import best_partners
from splatree.lod.build import build_levels, leaves_of
from splatree.lod.options import BuildOptions
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene

__all__ = ["fingerprint"]

NUM_ROWS = 300


@cache
def fingerprint() -> str:
    """A digest of fixed Gaussians, made of whole numbers alone so that bits are the same everywhere.

    It is of their trees by either method, and of what merging each with its cheapest partner changes.
    """
    numbers = (np.arange(14 * NUM_ROWS, dtype=np.int64) * 7919 % 10007).reshape(NUM_ROWS, 14).astype(np.float32)
    numbers /= np.float32(8192)
    gaussians = Gaussians(
        np.ascontiguousarray(numbers[:, :3]),
        np.ascontiguousarray(numbers[:, 3:7]) + np.float32(0.125),
        np.ascontiguousarray(numbers[:, 7:10]) - np.float32(4),
        np.ascontiguousarray(numbers[:, 10]) * 4 - np.float32(2),
        np.ascontiguousarray(numbers[:, 11:14]).reshape(NUM_ROWS, 1, 3),
    )
    digest = hashlib.blake2b(digest_size=8)
    for options in (BuildOptions(radius=0.05), BuildOptions("pairs", pixel_size=0.01)):
        tree = build_levels(leaves_of(Scene.flat(gaussians)), options, threads=1)
        for column in (*vars(tree.gaussians).values(), tree.tree.extents, tree.tree.subtree_end):
            digest.update(np.ascontiguousarray(column).data)
    _, costs, _ = best_partners(gaussians, np.ones(NUM_ROWS, np.float32), dilation=0.0, threads=1)
    digest.update(costs.data)
    return digest.hexdigest()
