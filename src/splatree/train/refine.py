"""Refine a tree: its inner nodes learn, from pictures of all leaves, what the leaves below them look like from afar.

A merged node is made from the moments of what it stands for. It knows nothing of what hides what, of gaps, of the colours
that are seen. Here it learns that: a view is drawn from the cut at a random τ_R, compared with the teacher's picture of the
same view (`Lesson`), and the nodes of the cut take a step along the derivative of ½ Σ |X − Y|² (kernels/reference/backward.py).

- Leaves stay bit for bit, and so do the tree, its extents and the order of rows: the cut of a view is the same before and after.
- The cuts are those of the scene as it came. A node learns its opacity and colour, and its shape where the cut does not look
  at it (train/proxies.py).
- Colours take the step that cannot overshoot (`Proxies.paint`); opacity and shape take one of Adam.
- A node's first steps are shorter, and all of them where pictures are nearly right, so that none is thrown off a good start.
- A node around which pictures did not get better goes back to what it was.
- Every eighth view is kept to judge by. If pictures of these did not get better in the mean, the scene is given back as it came.

Source: the scheme is our own (docs/explanation/refine.md); what it stands on is Kerbl 2023 for the derivatives and Kingma
2015 for the steps. Cost: about 20 ms of processor time a step at 320 × 240 px, and three drawings of each view besides."""

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import InputError
from splatree.io import untrusted
from splatree.kernels.devices import DeviceName, training_stages_of
from splatree.lod.blocks import with_blocks
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.gaussians import Gaussians
from splatree.scene.given import check_threads, given
from splatree.scene.gradients import Moments
from splatree.scene.literals import as_python
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64
from splatree.train.checkpoint import Identity, check_folder, check_shapes, load, save
from splatree.train.lessons import Lesson, lessons_of, made_views
from splatree.train.options import RunFiles
from splatree.train.refine_options import RefineOptions
from splatree.train.school import Course, School

__all__ = ["Refined", "refine"]

HELD_OUT = 8
"""Every so many views one is kept to judge by."""

JUDGED_AGAIN = 1.3
"""What judging takes afterwards, of what it took before: the judge's views are drawn twice then."""

CALIBRATION = "calibration"
"""The record of a τ that was chosen for the nodes as they were (render/calibrate.py)."""


@dataclass(frozen=True, eq=False)
class Refined:
    """A scene that learned, and what that brought in views that were kept to judge by.

    Example:
        >>> refined = st.refine(scene, st.RefineOptions(iterations=20, made_views=8))
        >>> refined.gain >= 0, refined.num_learned <= refined.num_nodes
        (True, True)
    """

    scene: Scene
    """The scene; the one that was given if it gained nothing."""
    iterations: int
    """Steps made."""
    before: Float64[Array, "j"]
    """PSNR of each judge's view at the middle τ_R against the teacher, dB, before."""
    after: Float64[Array, "j"]
    """The same afterwards."""
    num_learned: int
    """Inner nodes that are different now."""
    num_nodes: int
    """Inner nodes."""
    cpu_seconds: float
    """Processor time that it took."""
    notes: tuple[str, ...]
    """What the scene lost, a sentence each."""
    stopped: bool = False
    """Whether the run was stopped before its end."""

    @property
    def gain(self) -> float:
        """Mean over the judge's views, dB."""
        return float(np.mean(self.after - self.before))


@checked
def refine(
    scene: Scene,
    options: RefineOptions | None = None,
    *,
    cameras: Iterable[Camera] | None = None,
    files: RunFiles | None = None,
    stop: Callable[[], bool] = lambda: False,
    device: DeviceName = "cpu",
    threads: int = 0,
) -> Refined:
    """Let the inner nodes of a tree learn what the leaves below them look like.

    Args:
        scene: a scene with levels.
        options: time, teacher, range of cuts; None: the defaults.
        cameras: views to learn from; None: views are made all round the scene, for scenes that are seen from outside.
        files: where checkpoints of the run are kept; None: nowhere.
        stop: asked after each step; True ends the run there, with a checkpoint.
        device: where pictures are drawn and steps are computed, `cpu`, `cuda` or `reference`; rows are selected on the
            processor.
        threads: threads to use; 0: all.

    Returns:
        The scene, and what was gained. Clusters and a calibrated τ are dropped, since they belong to the nodes as they were.

    Raises:
        InputError: the scene has no levels, there are fewer than two cameras, or one has a lens; or a run cannot go on.
        FormatError: a checkpoint is damaged.
        OutputError: a checkpoint cannot be written; the last one is whole.
        DeviceError: the device is not there, has failed, or has too little memory.

    Source:
        docs/explanation/refine.md; derivatives as in Kerbl 2023, Appendix A.

    Example:
        >>> refined = st.refine(scene, st.RefineOptions(iterations=20, made_views=8))
        >>> len(refined.scene) == len(scene), refined.iterations
        (True, 20)
    """
    options, files = given(options, RefineOptions, "refine: options"), given(files, RunFiles, "refine: files")
    check_threads(threads)
    began, cameras = time.process_time(), None if cameras is None else several(cameras)
    _check(scene, cameras, files)
    original, stages = scene, training_stages_of(device)
    scene, notes = _bare(scene)
    scene = with_blocks(scene)
    views = made_views(scene, options.made_views, options.seed) if cameras is None else cameras
    school, course, earlier_s, identity = School(scene, stages, threads), Course(options.iterations), 0.0, None
    learned: _Learned | None = None
    if files.folder is not None:
        identity = _identity(scene, views, options)
        if files.resume:
            learned = load(files.folder, identity, partial(_restored, wanted=school.proxies.arrays()))
            course, earlier_s = learned.course, learned.spent_s

    def spent_s() -> float:
        return earlier_s + time.process_time() - began

    def keep() -> None:
        if files.folder is not None and identity is not None:
            save(files.folder, identity, school.proxies.arrays(), {**asdict(course), "spent_s": spent_s()})

    lessons = lessons_of(scene, views, options.teacher, device=device, threads=threads)
    held = {i for i in range(len(lessons)) if i % HELD_OUT == HELD_OUT // 2} or {len(lessons) - 1}
    learned_from = [lesson for i, lesson in enumerate(lessons) if i not in held]
    judges = [lessons[i] for i in sorted(held)]
    looked_at = _at_all_sizes(learned_from[::2], options)
    judged = [(lesson, math.sqrt(options.finest * options.coarsest)) for lesson in judges]
    judging = time.process_time()
    before, errors_before = school.judge(judged), school.errors(looked_at)
    judging = JUDGED_AGAIN * (time.process_time() - judging)
    if learned is not None:
        school.proxies.go_on(learned.gaussians, learned.moments)
    end = time.process_time() + 60 * options.minutes - spent_s() - judging
    stopped = school.learn(learned_from, options, course, end, stop=stop, keep=keep)
    keep()
    worse = np.flatnonzero(school.errors(looked_at) > errors_before)
    whole = school.proxies.scene()
    after = school.judge(judged)
    school.proxies.forget(worse)
    careful = school.judge(judged)
    if careful.mean() >= after.mean():
        whole, after = school.proxies.scene(), careful
    differs = _num_different(scene, whole)
    if after.mean() <= before.mean() or not differs:
        whole, after, differs, notes = original, before, 0, ()
    else:
        record = _record(options, course.step, float(np.mean(after - before)), stopped=stopped)
        metadata = {**whole.source.metadata, "refined": record}
        whole = replace(whole, source=replace(whole.source, metadata=metadata))
    return Refined(whole, course.step, before, after, differs, len(school.proxies.rows), spent_s(), notes, stopped)


def _check(scene: Scene, cameras: Sequence[Camera] | None, files: RunFiles) -> None:
    """Refuse what nothing can be learned from, before any work is done."""
    if files.replay is not None:
        raise InputError("refine: files: found a log to replay, wanted none; options.iterations repeats a run")
    if scene.tree.is_leaf.all():
        raise InputError("refine: found a scene without levels, wanted inner nodes that can learn; build levels first")
    if files.folder is not None:
        check_folder(files.folder, resume=files.resume)
    if cameras is None:
        return
    if len(cameras) < 2:
        raise InputError(
            f"refine: found {len(cameras)} camera, wanted at least 2: one to learn from and one to judge by"
        )
    for camera in cameras:
        if camera.lens is not None:
            raise InputError(f"refine: camera {camera.name!r}: found a lens, wanted a pinhole")


def _identity(scene: Scene, cameras: Sequence[Camera], options: RefineOptions) -> Identity:
    """What a run is begun with: options, and digests of all that its pictures are made from."""
    tree, of_scene, of_cameras = scene.tree, hashlib.blake2b(digest_size=16), hashlib.blake2b(digest_size=16)
    columns = (*vars(scene.gaussians).values(), tree.subtree_end, tree.extents, tree.curves, scene.ids)
    for column in columns:
        of_scene.update(b"none" if column is None else np.ascontiguousarray(column).data)
    drawn_as = (scene.mode, scene.threshold, scene.tile_rule, None if tree.record is None else tree.record.profile)
    of_scene.update(repr(as_python(drawn_as)).encode())
    for camera in cameras:
        of_cameras.update(camera.camera_from_world.tobytes() + camera.K.tobytes())
        of_cameras.update(repr((int(camera.width), int(camera.height), float(camera.near))).encode())
    return Identity("refine", asdict(options), {"scene": of_scene.hexdigest(), "cameras": of_cameras.hexdigest()})


@dataclass(frozen=True, eq=False)
class _Learned:
    """What a run had learned when it was written down."""

    gaussians: Gaussians
    """What the inner nodes had become (`Proxies.learned`)."""
    moments: Moments
    """Of the optimiser."""
    course: Course
    """How far learning had come."""
    spent_s: float
    """Processor seconds of the run."""


def _restored(
    arrays: Mapping[str, Array], about: Mapping[str, Any], where: str, *, wanted: Mapping[str, Array]
) -> _Learned:
    """What had been learned, as large as ``wanted``."""
    check_shapes(arrays, {name: array.shape for name, array in wanted.items()}, where)
    num_steps = None if about["wanted"] is None else untrusted.integer(about, "wanted", where)
    return _Learned(
        Gaussians(*(arrays[field.name] for field in fields(Gaussians))),
        Moments(arrays["moments"], arrays["steps"]),
        Course(num_steps, untrusted.integer(about, "step", where), untrusted.number(about, "timed_s", where)),
        untrusted.number(about, "spent_s", where),
    )


def _at_all_sizes(lessons: list[Lesson], options: RefineOptions) -> list[tuple[Lesson, float]]:
    """Lessons with a τ_R each, from the finest to the coarsest evenly in its logarithm: nodes of all sizes are drawn."""
    share = np.random.default_rng([options.seed, 3]).permutation((np.arange(len(lessons)) + 0.5) / len(lessons))
    return list(zip(lessons, (options.finest * (options.coarsest / options.finest) ** share).tolist(), strict=True))


def _bare(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Without what belongs to the nodes as they are, and a sentence for each thing."""
    notes = []
    if scene.clusters is not None:
        notes.append(
            "the clusters were made for the nodes as they were: make them again with build --flat --clusters auto"
        )
    metadata = dict(scene.source.metadata)
    threshold, rule = scene.threshold, scene.tile_rule
    if metadata.pop(CALIBRATION, None) is not None:
        notes.append("the τ of the scene was chosen for the nodes as they were: choose it again with calibrate")
        threshold, rule = ALPHA_THRESHOLD, None
    source = replace(scene.source, metadata=metadata)
    return replace(scene, clusters=None, threshold=threshold, tile_rule=rule, source=source), tuple(notes)


def _num_different(a: Scene, b: Scene) -> int:
    names = ("quats", "log_scales", "logit_opacities", "sh")
    pairs = ((getattr(a.gaussians, name), getattr(b.gaussians, name)) for name in names)
    differs = np.zeros(len(a), bool)
    for one, other in pairs:
        if one is not other:
            differs |= (one != other).reshape(len(a), -1).any(axis=1)
    if a.tree.curves is not b.tree.curves and a.tree.curves is not None and b.tree.curves is not None:
        differs |= (a.tree.curves != b.tree.curves).any(axis=1)
    return int(differs.sum())


def _record(options: RefineOptions, iterations: int, gain: float, *, stopped: bool) -> str:
    learned_by = {
        "iterations": iterations,
        "teacher": options.teacher,
        "finest": options.finest,
        "coarsest": options.coarsest,
    }
    return json.dumps({**learned_by, "seed": options.seed, "gain_db": round(gain, 3), "stopped": stopped})
