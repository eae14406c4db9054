"""A scene in the mode that a user names, where its file does not say it.

The mode of leaves is a label: they are drawn otherwise, and that is all. Merged nodes are made for one mode, and are wrong in
the other (docs/explanation/modes.md). So levels of detail keep the mode that they were made for.
"""

from dataclasses import replace

from splatree.errors import InputError
from splatree.scene.names import Mode
from splatree.scene.scene import Scene

__all__ = ["check_mode_of_levels", "in_mode"]


def in_mode(scene: Scene, mode: Mode | None) -> Scene:
    """The scene, drawn in another mode; None: as it is.

    Raises:
        InputError: it has levels of detail, which were made for its own mode.
    """
    if mode is None:
        return scene
    if scene.tree.num_leaves < len(scene):
        check_mode_of_levels(mode, None if scene.tree.record is None else scene.tree.record.mode)
    return replace(scene, mode=mode)


def check_mode_of_levels(mode: Mode | None, made_for: Mode | None) -> None:
    """Refuse a mode that levels of detail were not made for; levels that do not say theirs (None) may have any.

    Raises:
        InputError: they were made for another mode.
    """
    if mode is not None and made_for not in (None, mode):
        raise InputError(
            f"mode: found {mode} for levels of detail that were made for {made_for}, and look wrong in another mode; leave the "
            f"mode out, or build the levels anew from their leaves: splatree build in.splatree out.splatree --mode {mode}"
        )
