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

import json
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import InputError
from splatree.kernels.contract import TrainingStages
from splatree.kernels.devices import DeviceName, training_stages_of
from splatree.lod.blocks import with_blocks
from splatree.lod.select import select
from splatree.progress import task
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.given import check_threads, given
from splatree.scene.gradients import PictureGradients, SplatGradients
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import View, view_of
from splatree.shapes import Array, Float64
from splatree.train.lessons import Lesson, lessons_of, made_views
from splatree.train.proxies import Drawn, Proxies
from splatree.train.refine_options import RefineOptions

__all__ = ["Refined", "refine"]

HELD_OUT = 8
"""Every so many views one is kept to judge by."""

RAMP_STEPS = 16
"""Steps until a node moves at the full rate."""

WRONG = 0.07
"""Mean error of the pixels that a node covers from which on its opacity and shape move at the full rate; nearer to the teacher
they move in proportion. Adam alone moves a node that is right as far as one that is wrong."""

LAST_RATE = 0.1
"""Of the first rate, at the end; in between it falls evenly."""

TIMED = 20
"""Steps that are timed before their number is fixed."""

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
    device: DeviceName = "cpu",
    threads: int = 0,
) -> Refined:
    """Let the inner nodes of a tree learn what the leaves below them look like.

    Args:
        scene: a scene with levels.
        options: time, teacher, range of cuts; None: the defaults.
        cameras: views to learn from; None: views are made all round the scene, for scenes that are seen from outside.
        device: where pictures are drawn and steps are computed, `cpu`, `cuda` or `reference`; rows are selected on the
            processor.
        threads: threads to use; 0: all.

    Returns:
        The scene, and what was gained. Clusters and a calibrated τ are dropped, since they belong to the nodes as they were.

    Raises:
        InputError: the scene has no levels, there are fewer than two cameras, or one has a lens.
        DeviceError: the device is not there, has failed, or has too little memory.

    Source:
        docs/explanation/refine.md; derivatives as in Kerbl 2023, Appendix A.

    Example:
        >>> refined = st.refine(scene, st.RefineOptions(iterations=20, made_views=8))
        >>> len(refined.scene) == len(scene), refined.iterations
        (True, 20)
    """
    options = given(options, RefineOptions, "refine: options")
    check_threads(threads)
    began, cameras = time.process_time(), None if cameras is None else several(cameras)
    if scene.tree.is_leaf.all():
        raise InputError("refine: found a scene without levels, wanted inner nodes that can learn; build levels first")
    if cameras is not None and len(cameras) < 2:
        raise InputError(
            f"refine: found {len(cameras)} camera, wanted at least 2: one to learn from and one to judge by"
        )
    original, stages = scene, training_stages_of(device)
    scene, notes = _bare(scene)
    scene = with_blocks(scene)
    views = made_views(scene, options.made_views, options.seed) if cameras is None else cameras
    lessons = lessons_of(scene, views, options.teacher, device=device, threads=threads)
    held = {i for i in range(len(lessons)) if i % HELD_OUT == HELD_OUT // 2} or {len(lessons) - 1}
    learned_from = [lesson for i, lesson in enumerate(lessons) if i not in held]
    judges = [lessons[i] for i in sorted(held)]

    school = _School(scene, stages, threads)
    looked_at = _at_all_sizes(learned_from[::2], options)
    judged = [(lesson, math.sqrt(options.finest * options.coarsest)) for lesson in judges]
    judging = time.process_time()
    before, errors_before = school.judge(judged), school.errors(looked_at)
    judging = JUDGED_AGAIN * (time.process_time() - judging)
    iterations = school.learn(learned_from, options, began + 60 * options.minutes - judging)
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
        metadata = {**whole.source.metadata, "refined": _record(options, iterations, float(np.mean(after - before)))}
        whole = replace(whole, source=replace(whole.source, metadata=metadata))
    spent = time.process_time() - began
    return Refined(whole, iterations, before, after, differs, len(school.proxies.rows), spent, notes)


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


def _record(options: RefineOptions, iterations: int, gain: float) -> str:
    fields = {
        "iterations": iterations,
        "teacher": options.teacher,
        "finest": options.finest,
        "coarsest": options.coarsest,
    }
    return json.dumps({**fields, "seed": options.seed, "gain_db": round(gain, 3)})


class _School:
    """A scene whose inner nodes learn."""

    def __init__(self, scene: Scene, stages: TrainingStages, threads: int) -> None:
        self._scene, self._threads, self._stages = scene, threads, stages
        self.proxies = Proxies(scene)

    def learn(self, lessons: list[Lesson], options: RefineOptions, end: float) -> int:
        """Make the steps, until the processor's clock is at ``end`` if they are not counted; returns their number."""
        rng = np.random.default_rng([options.seed, 2])
        order, wanted, done = np.zeros(0, np.int64), options.iterations, 0
        at_start = time.process_time()
        with task("refine inner nodes", 1.0) as advance:
            while wanted is None or done < wanted:
                if wanted is None and done == TIMED:
                    now = time.process_time()
                    wanted = TIMED + max(0, int((end - now) / ((now - at_start) / TIMED)))
                    continue
                if not len(order):
                    order = rng.permutation(len(lessons))
                lesson, order = lessons[order[0]], order[1:]
                tau = math.exp(rng.uniform(math.log(options.finest), math.log(options.coarsest)))
                share = done / wanted if wanted else 0.0
                self._step(lesson, tau, options.rate * (1 - (1 - LAST_RATE) * share))
                done += 1
                advance((1 - share) / (wanted - done + 1) if wanted else 0.0)
        return done

    def _step(self, lesson: Lesson, tau: float, rate: float) -> None:
        view, drawn, splats, bins, picture = self._draw(lesson.camera, tau)
        sums = self._compared(lesson, view, splats, bins, picture)
        few, of_few = self._inner(splats, sums)
        assert of_few.weights is not None and of_few.errors is not None
        found = self._stages.project_backward(self.proxies.drawn, few, of_few, view, threads=self._threads)
        derivatives = self.proxies.derivatives(drawn, few, found)
        self.proxies.paint(derivatives, of_few.weights, rate)
        nodes = derivatives.rows
        before = self.proxies.shapes(nodes)
        self._stages.step(
            self.proxies.learned,
            derivatives,
            self.proxies.moments,
            self.proxies.rates(rate),
            ramp_steps=RAMP_STEPS,
            threads=self._threads,
        )
        wrong = np.nan_to_num(of_few.errors / np.maximum(of_few.weights, np.float32(1e-9)), posinf=0)
        self.proxies.hold_back(nodes, before, np.minimum(1, wrong / np.float32(WRONG)))

    def _compared(self, lesson: Lesson, view: View, splats: Splats, bins: TileBins, picture: Picture) -> SplatGradients:
        """Derivatives of ½ Σ |X − Y|² by the splats, with the errors of the pixels that each covers."""
        wrong = picture.image - lesson.picture * np.float32(1 / 255)
        upstream = PictureGradients(wrong, errors=np.abs(wrong).mean(axis=2))
        return self._stages.blend_backward(splats, bins, view, picture, upstream, threads=self._threads)

    def _draw(self, camera: Camera, tau: float) -> tuple[View, Drawn, Splats, TileBins, Picture]:
        view = view_of(self._scene, camera)
        rows = select(self._scene, view, SelectOptions(pixel_error=tau), threads=self._threads).rows
        drawn = self.proxies.draw(view, rows)
        splats = self._stages.project(self.proxies.drawn, self._scene.ids, rows, view, threads=self._threads)
        bins = self._stages.bin(splats, view, threads=self._threads)
        return view, drawn, splats, bins, self._stages.blend(splats, bins, view, threads=self._threads)

    def _inner(self, splats: Splats, sums: SplatGradients) -> tuple[Splats, SplatGradients]:
        """The splats of inner nodes alone."""
        chosen = self.proxies.is_node(splats.rows)
        count = int(chosen.sum())
        few = Splats(splats.rows[chosen], splats.records[chosen], np.arange(count, dtype=np.int32))
        assert sums.weights is not None and sums.errors is not None
        of_few = SplatGradients(
            sums.moments[chosen], sums.colors[chosen], None, sums.weights[chosen], sums.errors[chosen]
        )
        return few, of_few

    def judge(self, lessons: list[tuple[Lesson, float]]) -> Float64[Array, "j"]:
        """PSNR of the cut of each view at its τ_R."""
        scores = []
        for lesson, tau in lessons:
            image = np.clip(self._draw(lesson.camera, tau)[4].image, 0, 1)
            square = np.mean((image - lesson.picture.astype(np.float64) / 255) ** 2)
            scores.append(-10 * math.log10(square + 1e-10))
        return np.array(scores)

    def errors(self, lessons: list[tuple[Lesson, float]]) -> Float64[Array, "n"]:
        """How wrong the pixels are that each row covers, summed over the views, each at its τ_R."""
        total = np.zeros(len(self._scene))
        for lesson, tau in lessons:
            view, _, splats, bins, picture = self._draw(lesson.camera, tau)
            total[splats.rows] += np.asarray(self._compared(lesson, view, splats, bins, picture).errors)
        total[self._scene.tree.is_leaf] = 0
        return total
