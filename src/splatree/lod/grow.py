"""Grow levels over a forest by the method that was chosen."""

from splatree.lod.forest import Forest
from splatree.lod.grow_pairs import grow_by_pairs
from splatree.lod.grow_radius import grow_by_radius
from splatree.lod.resolve import ResolvedBuild

__all__ = ["grow"]


def grow(forest: Forest, resolved: ResolvedBuild, *, num_levels: int | None = None, threads: int = 0) -> Forest:
    """The forest with further levels, from the size on that it was grown to.

    Growing in two steps gives the same bits as growing at once, for levels by a radius. Levels by pairs look for neighbours anew
    when growth goes on, so their trees differ in a few pairs.

    Args:
        forest: leaves (`forest_of_leaves`), roots of parts (`forest_of_roots`), or what has grown over them.
        resolved: what was decided for the whole scene.
        num_levels: sizes to go through, whatever is left then: parts of one scene are grown by the same number. None: until at
            most ``max_roots`` nodes are left, or sizes end.
        threads: threads to use; 0: all.

    Returns:
        The grown forest; the given one is as it was.
    """
    by_method = grow_by_pairs if resolved.method == "pairs" else grow_by_radius
    return by_method(forest, resolved, num_levels=num_levels, threads=threads)
