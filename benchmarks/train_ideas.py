"""Ideas for training, one at a time: what each wins or loses on held-out photographs beside the trainer as it is.

``python benchmarks/train_ideas.py drone as-is seed drop`` trains the named set once for each idea. All runs of a command take
turns of 25 steps in one process, so the machine is equally fast for all of them. They make equally many steps, or, with
``--minutes``, take equally many processor minutes. Rows of other sets, lengths and ideas are kept. An idea changes the trainer
from outside: none of them is part of the library.
"""

import argparse
import importlib
import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import harness
import splatree as st
from splatree.maths.rotations import matrices_from_quats
from splatree.scene.gaussians import Gaussians
from train import known

run, step, schedule = (importlib.import_module(f"splatree.train.{name}") for name in ("run", "step", "schedule"))

ABOUT = """Held-out photographs (every 8th) at half of their size, at the end of a run: PSNR with a gain for each channel fitted
on the left half and scored on the right half, as rendered, and SSIM. Training: each sixth training photograph with its own
exposure; the gap is to held-out ones with the gain fitted. Ideas of one command took turns, one thread.""".replace(
    "\n", " "
)

TURN = 25
"""Steps of a run before the next one takes its turn."""


@dataclass(frozen=True)
class Photographs:
    """A set of photographs to try ideas on."""

    folder: str
    """In the shared data."""
    max_gaussians: int
    """Gaussians at most."""
    steps: int
    """Steps unless told otherwise."""


SETS = {
    "drone": Photographs("caliterra_drone", 120_000, 1400),
    "plush": Photographs("snowmiku_plush_small", 50_000, 660),
}


class Idea:
    """The trainer as it is; subclasses change one thing. `share` is how much of the run is done."""

    options: ClassVar[dict[str, Any]] = {}
    share = 0.0

    def __init__(self) -> None:
        self.rng = np.random.default_rng(1)

    def rates(self, share: float, extent: float, moments: Any, num_coefficients: int) -> np.ndarray:
        self.share = share
        return USUAL["rates"](share, extent, moments, num_coefficients)

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        return USUAL["learn"](rows, seen, target, exposure, rates, extent, drawing)

    def regularise(self, gaussians: Gaussians, gradients: Any, extent: float) -> None:
        USUAL["regularise"](gaussians, gradients, extent)

    def division(self, schedule: Any, share: float) -> int:
        return int(USUAL["division"](schedule, share))

    def sh_degree(self, schedule: Any, share: float) -> int:
        return int(USUAL["sh_degree"](schedule, share))


USUAL: dict[str, Callable[..., Any]] = {
    "rates": run.rates,
    "learn": run.learn,
    "regularise": step._regularise,
    "division": schedule.Schedule.division,
    "sh_degree": schedule.Schedule.sh_degree,
}


def install(idea: Idea) -> None:
    """Let the trainer do as an idea says, from now on, and be scored at the end alone."""
    run.KEPT_AT = ()
    run.rates, run.learn, step._regularise = idea.rates, idea.learn, idea.regularise
    schedule.Schedule.division = lambda self, share: idea.division(self, share)
    schedule.Schedule.sh_degree = lambda self, share: idea.sh_degree(self, share)


class Seed(Idea):
    """Another order of photographs and other births: how much of a difference is chance."""

    options: ClassVar[dict[str, Any]] = {"seed": 1}


class Weighted(Idea):
    """Other weights in the loss of the mean opacity and of the mean scale, in those of today."""

    opacity, scale = 1.0, 1.0

    def regularise(self, gaussians: Gaussians, gradients: Any, extent: float) -> None:
        logits, scales = gradients.logit_opacities.copy(), gradients.log_scales.copy()
        USUAL["regularise"](gaussians, gradients, extent)
        gradients.logit_opacities[:] = logits + self.opacity * (gradients.logit_opacities - logits)
        gradients.log_scales[:] = scales + self.scale * (gradients.log_scales - scales)


class Opacity(Weighted):
    """Five times the weight on opacity."""

    opacity = 5.0


class Scale(Weighted):
    """Five times the weight on size."""

    scale = 5.0


class Free(Weighted):
    """No weight on opacity and size."""

    opacity, scale = 0.0, 0.0


class Drop(Idea):
    """A tenth of the Gaussians left out of each step, the others' opacity made up for it, as DropGaussian (Park 2025) does."""

    left_out = 0.1

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        stages, keeps = drawing.stages, 1 - self.left_out
        opacity = rows.gaussians.opacities().astype(np.float64)
        raised = np.clip(opacity / keeps, 1e-6, 0.999)
        logits = np.log(raised / (1 - raised)).astype(np.float32)
        by_logit = np.where(raised < 0.999, (1 - opacity) / np.maximum(1 - raised, 1e-6), 0).astype(np.float32)
        gaussians = replace(rows.gaussians, logit_opacities=logits)
        drawn = np.flatnonzero(self.rng.random(len(gaussians)) < keeps).astype(np.int32)

        def project(_: Any, blocks: Any, __: Any, view: Any, **more: Any) -> Any:
            return stages.project(gaussians, blocks, drawn, view, **more)

        def project_backward(_: Any, splats: Any, by_splats: Any, view: Any, **more: Any) -> Any:
            found = stages.project_backward(gaussians, splats, by_splats, view, **more)
            found.logit_opacities[:] *= by_logit[found.rows]
            return found

        drawing = replace(drawing, stages=changed(stages, project=project, project_backward=project_backward))
        return USUAL["learn"](rows, seen, target, exposure, rates, extent, drawing)


class Grid(Idea):
    """4 × 3 gains for each photograph with bilinear weights, held near 1, from three fifths of the run on.

    Over the photographs their mean at each node is 1.
    """

    begins, prior = 0.6, 0.05

    def __init__(self) -> None:
        super().__init__()
        self.gains: dict[str, np.ndarray] = {}
        self.visits: dict[str, int] = {}
        self.bases: dict[tuple[int, int], np.ndarray] = {}

    def basis(self, height: int, width: int) -> np.ndarray:
        """Bilinear weights of the nodes, [h w 12]."""
        if (height, width) not in self.bases:
            y, x = (
                np.maximum(0, 1 - np.abs(np.linspace(0, n - 1, size)[:, None] - np.arange(n)))
                for n, size in ((3, height), (4, width))
            )
            self.bases[height, width] = (y[:, None, :, None] * x[None, :, None, :]).reshape(height, width, 12)
        return self.bases[height, width]

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        name, stages = target.camera.name, drawing.stages
        basis = self.basis(*target.photo.shape[:2])
        nodes = np.ones(12)
        if name in self.gains:
            nodes = self.gains[name] / np.exp(np.mean([np.log(gains) for gains in self.gains.values()], axis=0))
        shade = (basis @ nodes).astype(np.float32)[..., None]

        def photo_loss(image: Any, photo: Any, gain: Any, **more: Any) -> Any:
            found = stages.photo_loss(np.ascontiguousarray(image * shade), photo, gain, **more)
            return replace(found, image=np.ascontiguousarray(found.image * shade))

        drawing = replace(drawing, stages=changed(stages, photo_loss=photo_loss))
        loss, image = USUAL["learn"](rows, seen, target, exposure, rates, extent, drawing)
        if self.share >= self.begins:
            self.visit(name, image * np.diagonal(exposure[:, :3]), target.photo / np.float32(255), basis)
        return loss, image

    def visit(self, name: str, image: np.ndarray, photo: np.ndarray, basis: np.ndarray) -> None:
        """Mix in the gains that fit a photograph best."""
        x, y, b = (plane[2::4, 2::4] for plane in (image, photo, basis))
        each = np.einsum("hwc,hwn->hwcn", x, b).reshape(-1, 12)
        prior = self.prior * np.square(x).sum() / 12
        best = np.linalg.solve(each.T @ each + prior * np.eye(12), each.T @ y.reshape(-1) + prior)
        self.visits[name] = self.visits.get(name, 0) + 1
        before, weight = self.gains.get(name, np.ones(12)), max(0.1, 1 / self.visits[name])
        self.gains[name] = np.clip(before + weight * (best - before), 0.5, 2)


class SmallLonger(Idea):
    """Photographs at a quarter of their size until p = 0.75."""

    def division(self, schedule: Any, share: float) -> int:
        return int(USUAL["division"](schedule, min(share, 0.59) if share < 0.75 else share))


class HarmonicsLater(Idea):
    """No harmonics until half of the run."""

    def sh_degree(self, schedule: Any, share: float) -> int:
        return int(USUAL["sh_degree"](schedule, share)) if share >= 0.5 else 0


class HarmonicsDecay(Idea):
    """Harmonics that shrink at each step by their rate times 0.3."""

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        found = super().learn(rows, seen, target, exposure, rates, extent, drawing)
        rows.gaussians.sh[:, 1:] *= np.float32(1 - 0.3 * float(rates[14]))
        return found


class Noise(Idea):
    """Noise on the means of faint Gaussians along their own axes, as 3DGS-MCMC (Kheradmand 2024, Eq. 8) has it."""

    times = 5e5

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        found = super().learn(rows, seen, target, exposure, rates, extent, drawing)
        g = rows.gaussians
        some = np.flatnonzero(g.opacities() < 0.1)
        weight = 1 / (1 + np.exp(100.0 * (g.opacities()[some] - 0.005)))
        axes = matrices_from_quats(g.quats[some])
        square = axes * np.exp(2 * g.log_scales[some].astype(np.float64))[:, None, :] @ axes.transpose(0, 2, 1)
        noise = self.rng.normal(size=(len(some), 3)) * (weight * self.times * float(rates[0]) / extent)[:, None]
        g.means[some] += np.einsum("nij,nj->ni", square, noise).astype(np.float32)
        return found


class Squares(Idea):
    """In the last fifth of the run squares of small differences (Huber, δ = 0.04) in place of their absolute values."""

    begins, delta = 0.8, 0.04

    def learn(self, rows: Any, seen: Any, target: Any, exposure: Any, rates: Any, extent: float, drawing: Any) -> Any:
        stages = drawing.stages

        def photo_loss(image: Any, photo: Any, gain: Any, *, ssim_weight: float, **more: Any) -> Any:
            found = stages.photo_loss(image, photo, gain, ssim_weight=ssim_weight, **more)
            scale = np.asarray(gain, np.float32)
            wrong = image * scale - photo * np.float32(1 / 255)
            weight = np.float32((1 - ssim_weight) / wrong.size)
            change = np.clip(wrong / np.float32(self.delta), -1, 1) - np.sign(wrong)
            return replace(found, image=np.ascontiguousarray(found.image + weight * scale * change))

        if self.share >= self.begins:
            drawing = replace(drawing, stages=changed(stages, photo_loss=photo_loss))
        return USUAL["learn"](rows, seen, target, exposure, rates, extent, drawing)


class SquaresAlways(Squares):
    """The same from the beginning."""

    begins = 0.0


def changed(stages: Any, **others: Callable[..., Any]) -> Any:
    """Stages of a back end with some of them replaced."""
    names = ("select", "project", "bin", "blend", "blend_backward", "project_backward", "photo_loss", "step")
    return SimpleNamespace(**{name: getattr(stages, name) for name in names} | others)


IDEAS: dict[str, type[Idea]] = {
    "as-is": Idea,
    "seed": Seed,
    "opacity": Opacity,
    "scale": Scale,
    "free": Free,
    "drop": Drop,
    "grid-late": Grid,
    "small-longer": SmallLonger,
    "harmonics-later": HarmonicsLater,
    "harmonics-decay": HarmonicsDecay,
    "noise": Noise,
    "squares": Squares,
    "squares-always": SquaresAlways,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", choices=SETS)
    parser.add_argument("ideas", nargs="*", choices=[*IDEAS, []])
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=int, help="of each run; None: those of the set")
    length.add_argument("--minutes", type=float, help="processor minutes of each run instead of steps")
    options = parser.parse_args()
    photographs = SETS[options.photographs]
    names = options.ideas or list(IDEAS)
    steps = None if options.minutes else options.steps or photographs.steps
    turns = Turns([IDEAS[name]() for name in names])
    label = f"{options.minutes:g} CPU min" if options.minutes else f"{steps} steps"

    def trained(i: int) -> None:
        folder = harness.DATA / "images" / photographs.folder
        idea = turns.ideas[i]
        given = st.TrainOptions(
            minutes=options.minutes, iterations=steps, max_gaussians=photographs.max_gaussians, **idea.options
        )
        with turns.of(i):
            found = st.train(folder, given, stop=lambda: turns.step(i), threads=1)
            keep(row(options.photographs, label, names[i], found, folder))

    threads = [threading.Thread(target=trained, args=(i,)) for i in range(len(names))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


class Turns:
    """Which run is next; one at a time, with its own idea in the trainer."""

    def __init__(self, ideas: list[Idea]) -> None:
        self.ideas = ideas
        self._changed = threading.Condition()
        self._waiting = list(range(len(ideas)))
        self._steps = [0] * len(ideas)

    def of(self, i: int) -> "Turn":
        """The whole of a run."""
        return Turn(self, i)

    def step(self, i: int) -> bool:
        """Count a step, and let the next one go on after some; never stops a run."""
        self._steps[i] += 1
        if self._steps[i] % TURN == 0:
            with self._changed:
                self._waiting.append(self._waiting.pop(0))
                self._changed.notify_all()
            self.wait(i)
        return False

    def wait(self, i: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting[0] == i)
        install(self.ideas[i])

    def leave(self) -> None:
        with self._changed:
            self._waiting.pop(0)
            self._changed.notify_all()


@dataclass(frozen=True)
class Turn:
    """From the first turn of a run to its last."""

    turns: Turns
    i: int

    def __enter__(self) -> None:
        self.turns.wait(self.i)

    def __exit__(self, *failed: object) -> None:
        self.turns.leave()


def row(photographs: str, length: str, name: str, found: st.Trained, folder: Path) -> dict[str, Any]:
    """What a run has come to."""
    last = found.history[-1]
    assert last.score is not None and last.score.psnr_fitted is not None
    training = known(found, folder)[0]
    return {
        "photographs": photographs,
        "length": length,
        "idea": name,
        "CPU s": last.cpu_s,
        "steps": last.iterations,
        "Gaussians": last.num_gaussians,
        "fitted": last.score.psnr_fitted,
        "PSNR": last.score.psnr,
        "SSIM": last.score.ssim,
        "training": training,
        "gap": training - last.score.psnr_fitted,
    }


def keep(found: dict[str, Any]) -> None:
    """Print a row, and keep it beside the others."""
    print(time.strftime("%H:%M:%S"), harness.table([found]).splitlines()[-1], flush=True)
    path = harness.RESULTS / "train_ideas.json"
    keys = ("photographs", "length", "idea")
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [row for row in kept if any(row[key] != found[key] for key in keys)]
    harness.save("train_ideas", sorted([*rows, found], key=place), about=ABOUT)


def place(row: dict[str, Any]) -> tuple[Any, ...]:
    """Where a row stands in the table."""
    return list(SETS).index(row["photographs"]), row["length"], list(IDEAS).index(row["idea"])


if __name__ == "__main__":
    main()
