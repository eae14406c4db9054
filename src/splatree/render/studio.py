"""Draw the views of a calibration at one τ after the other, in one session, and judge each τ."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from splatree.constants import ALPHA_THRESHOLD
from splatree.metrics.psnr import psnr
from splatree.render.calibration import CalibrateOptions, Trial
from splatree.render.contribution import tile_contributions
from splatree.render.session import Session
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame
from splatree.scene.options import RenderOptions
from splatree.shapes import Array

__all__ = ["BISECTIONS", "FOUND_BY_LOSS", "THRESHOLD_MAX", "Studio"]

FOUND_BY_LOSS: Final = ("target", "worst")
"""Policies that draw pictures at one τ after the other."""

THRESHOLD_MAX: Final = 0.5
"""Largest τ that is chosen: above it splats of medium opacity vanish altogether."""

BISECTIONS: Final = 8
"""Halvings of ln(0.5 / (1/255)) = 4.85: τ is found to 2 %."""


class Studio:
    """Draws the views at one τ after the other, in one session."""

    def __init__(
        self,
        session: Session,
        views: Sequence[Camera],
        options: CalibrateOptions,
        render: RenderOptions,
        photos: Mapping[str, Array],
    ) -> None:
        self.session, self.views, self.options, self.render, self.photos = session, views, options, render, photos
        self.advance: Callable[[float], None] = lambda units: None
        self.num_pairs_lossless = 0
        self.contribution = 0.0

    def draw(self, view: Camera, render: RenderOptions) -> Frame:
        self.advance(1)
        return self.session.trace(view, options=render)

    def draw_lossless(self) -> None:
        """Draw all views with the exact test at 1/255; keep their pictures, or else how far they are from the photographs."""
        lossless = replace(self.render, tile_rule="ellipse", pixels="hard", threshold=ALPHA_THRESHOLD)
        self.pictures: list[Array] = []
        self.photo_psnrs: list[float] = []
        contributions = []
        depths = []
        for view in self.views:
            frame = self.draw(view, lossless)
            depths.append(_mean_depth(frame))
            self.num_pairs_lossless += frame.bins.num_pairs
            if self.photos:
                self.photo_psnrs.append(psnr(_shown(frame), self.photos[view.name]))
            else:
                self.pictures.append(_shown(frame))
            if self.options.lists != "ellipse":
                frame = self.session.trace(view, options=replace(lossless, tile_rule=self.options.lists))
            contributions.append(tile_contributions(frame).mean(tiles=self.options.tiles, unit=self.options.unit))
        self.contribution = float(np.mean(contributions))
        self.halves = _halves(depths)

    def choose(self) -> tuple[Trial, list[Trial]]:
        """The trial that the policy asks for, and all that were made."""
        if self.options.policy in FOUND_BY_LOSS:
            return self._largest_within_budget()
        wanted = {
            "paper": self.options.lambda_g / self.contribution if self.contribution else math.inf,
            "release": self.options.lambda_g * self.contribution,
            "fixed": self.render.threshold or ALPHA_THRESHOLD,
        }[self.options.policy]
        trial = self.attempt(min(max(wanted, ALPHA_THRESHOLD), THRESHOLD_MAX))
        return trial, [trial]

    def _largest_within_budget(self) -> tuple[Trial, list[Trial]]:
        best = Trial(ALPHA_THRESHOLD, 0.0, 0.0, "", None, self.num_pairs_lossless)
        if self.render.tile_rule == "tau":  # not what was drawn as lossless
            best = self.attempt(ALPHA_THRESHOLD)
        above = self.attempt(THRESHOLD_MAX)
        trials = [best, above]
        if self.keeps(above):
            return above, trials
        for _ in range(BISECTIONS):
            trial = self.attempt(math.sqrt(best.threshold * above.threshold))
            trials.append(trial)
            if self.keeps(trial):
                best = trial
            else:
                above = trial
        return best, trials

    def keeps(self, trial: Trial) -> bool:
        """Whether a trial is within the budget."""
        loss = trial.worst_loss_db if self.options.policy == "worst" else trial.loss_db
        return loss <= self.options.loss_db

    def attempt(self, threshold: float) -> Trial:
        """Draw all views with one τ."""
        losses, errors, num_pairs = [], [], 0
        for i, view in enumerate(self.views):
            frame = self.draw(view, replace(self.render, threshold=threshold))
            num_pairs += frame.bins.num_pairs
            if self.photos:
                losses.append(self.photo_psnrs[i] - psnr(_shown(frame), self.photos[view.name]))
            else:
                errors.append(10 ** (-psnr(_shown(frame), self.pictures[i]) / 10))
                losses.append(10 * math.log10(1 + errors[-1] * 10 ** (self.options.scene_psnr / 10)))
        error = float(np.mean(errors)) if errors else 0.0
        worst = int(np.argmax(losses))
        return Trial(
            threshold=threshold,
            loss_db=max(float(np.mean(np.array(losses)[half])) for half in self.halves),
            worst_loss_db=float(losses[worst]),
            worst_view=self.views[worst].name or str(worst),
            psnr=-10 * math.log10(error) if error else None,
            num_pairs=num_pairs,
        )


def _mean_depth(frame: Frame) -> float:
    """Mean depth of what a picture shows; infinity if it shows nothing."""
    alpha = frame.result.alpha.astype(np.float64)
    shown = float(alpha.sum())
    return float((alpha * frame.result.depth).sum()) / shown if shown > 0 else math.inf


def _halves(depths: Sequence[float]) -> tuple[Array, Array]:
    """Numbers of the nearer and of the farther half of the views; all, if none shows anything."""
    order = np.argsort(depths, kind="stable")
    order = order[: int(np.isfinite(depths).sum())] if np.isfinite(depths).any() else order
    size = -(-len(order) // 2)
    return order[:size], order[len(order) - size :]


def _shown(frame: Frame) -> Array:
    """The picture as a screen shows it."""
    return np.clip(frame.result.image, 0, 1)
