"""The steps by which inner nodes learn, and the views by which they are judged.

A step draws the cut of a view at a random τ_R, compares it with the teacher's picture (`Lesson`), and moves the nodes of the cut
along the derivative of ½ Σ |X − Y|² (kernels/reference/backward.py). Which view and which τ_R a step takes follows from the seed
and the number of the step alone, so a run that stopped goes on alike.
"""

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from splatree.kernels.contract import TrainingStages
from splatree.lod.select import select
from splatree.progress import task
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.gradients import PictureGradients, SplatGradients
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import View, view_of
from splatree.shapes import Array, Float64
from splatree.train.checkpoint import KEPT_AT
from splatree.train.lessons import Lesson
from splatree.train.proxies import Drawn, Proxies
from splatree.train.refine_options import RefineOptions

__all__ = ["Course", "School"]

RAMP_STEPS = 16
"""Steps until a node moves at the full rate."""

WRONG = 0.07
"""Mean error of the pixels that a node covers from which on its opacity and shape move at the full rate; nearer to the teacher
they move in proportion. Adam alone moves a node that is right as far as one that is wrong."""

LAST_RATE = 0.1
"""Of the first rate, at the end; in between it falls evenly."""

TIMED = 20
"""Steps that are timed before their number is fixed."""


@dataclass
class Course:
    """How far learning has come; fields change as it goes on."""

    wanted: int | None
    """Steps in all; None: their number follows from what the first ones take."""
    step: int = 0
    """Steps made."""
    timed_s: float = 0.0
    """Processor seconds of these steps."""

    @property
    def share(self) -> float:
        """Share of the steps that are made; 0 while their number is not known."""
        return self.step / self.wanted if self.wanted else 0.0


class School:
    """A scene whose inner nodes learn."""

    def __init__(self, scene: Scene, stages: TrainingStages, threads: int) -> None:
        self._scene, self._threads, self._stages = scene, threads, stages
        self.proxies = Proxies(scene)

    def learn(
        self,
        lessons: list[Lesson],
        options: RefineOptions,
        course: Course,
        end: float,
        *,
        stop: Callable[[], bool],
        keep: Callable[[], None],
    ) -> bool:
        """Make the steps that are left.

        Args:
            lessons: what is learned from.
            options: range of cuts, rate, seed.
            course: how far learning has come; it changes.
            end: what the processor's clock may be at the end, if steps are not counted.
            stop: asked after each step; True ends the learning there.
            keep: called at the shares `KEPT_AT`.

        Returns:
            Whether it was stopped while steps were left.
        """
        plan = itertools.islice(_plan(len(lessons), options), course.step, None)
        with task("refine inner nodes", 1.0) as advance:
            told = course.share
            advance(told)
            while course.wanted is None or course.step < course.wanted:
                if course.wanted is None and course.step == TIMED:
                    course.wanted = TIMED + max(0, int((end - time.process_time()) / (course.timed_s / TIMED)))
                    continue
                begin = time.process_time()
                lesson, tau = next(plan)
                progress = 0.0 if course.step < TIMED else course.share
                self._step(lessons[lesson], tau, options.rate * (1 - (1 - LAST_RATE) * progress))
                course.step += 1
                course.timed_s += time.process_time() - begin
                before, told = told, course.share  # of a timed run, 0 until the number of steps is known
                advance(told - before)
                if stop():
                    return course.wanted is None or course.step < course.wanted
                if any(before < mark <= told < 1 for mark in KEPT_AT):
                    keep()
        return False

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


def _plan(num_lessons: int, options: RefineOptions) -> Iterator[tuple[int, float]]:
    """Lesson and τ_R of each step: every lesson comes once an epoch, and τ_R evenly in its logarithm."""
    rng = np.random.default_rng([options.seed, 2])
    while True:
        for lesson in rng.permutation(num_lessons).tolist():
            yield lesson, math.exp(rng.uniform(math.log(options.finest), math.log(options.coarsest)))
