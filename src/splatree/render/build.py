"""Build levels of detail by the method that suits the scene: chosen by pictures, which is why it stands beside what draws."""

import dataclasses

from splatree.lod.build import build_levels, leaves_of
from splatree.lod.options import BuildOptions
from splatree.render.trial import FEWEST, SAMPLE, middle_of, try_both
from splatree.scene.arguments import checked
from splatree.scene.given import check_threads, given
from splatree.scene.scene import Scene
from splatree.scene.trial import MethodTrial

__all__ = ["build_lod"]


@checked
def build_lod(scene: Scene, options: BuildOptions | None = None, *, threads: int = 0) -> Scene:
    """Build levels of detail over the leaves of a scene.

    Levels that the scene already has are dropped. The leaves are the given Gaussians bit for bit, in another order. The method
    `auto` builds a sample of the scene by a radius and by pairs and takes what gives the better picture of as many nodes
    (`try_methods`); what it found stays in ``tree.record.trial``. Fewer than 4,096 Gaussians are built by a radius untried.

    Args:
        scene: any scene.
        options: how the levels grow.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        The scene with its tree. ``ids`` keep the identity of the leaves (their row, if the scene had none); inner nodes have
        new ones. ``tree.record`` says how the levels were made, ``source.metadata["levels"]`` says the same to people.

    Raises:
        InputError: NaN or infinity in the Gaussians.

    Example:
        >>> import splatree as st
        >>> scene = st.build_lod(st.Scene.flat(st.Gaussians.empty()), st.BuildOptions(radius=0.05))
        >>> scene.tree.record.rule
        'radius-thinning'
    """
    options, flat = given(options, BuildOptions, "build_lod: options"), leaves_of(scene)
    check_threads(threads)
    method = options.only_method or ("radius" if len(flat) < FEWEST else None)
    if method is not None:
        return build_levels(flat, dataclasses.replace(options, method=method), threads=threads)
    tried = try_both(middle_of(flat, SAMPLE), options, threads=threads)
    trial, trees = tried.trial, tried.trees
    if trial.num_gaussians == len(flat):  # the sample is the scene
        return _with_trial(trees[trial.better], trial)
    del tried, trees
    tree = build_levels(flat, dataclasses.replace(options, method=trial.better), threads=threads)
    return _with_trial(tree, trial)


def _with_trial(tree: Scene, trial: MethodTrial) -> Scene:
    assert tree.tree.record is not None
    record = dataclasses.replace(tree.tree.record, trial=trial)
    return dataclasses.replace(tree, tree=dataclasses.replace(tree.tree, record=record))
