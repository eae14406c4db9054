"""Ideas for refinement, one at a time, at equal steps: what each adds to the gain, and to that of the worst view.

``python benchmarks/refine_ideas.py [scene] [idea …] [--steps 1000]``; without an idea, all of them. Rows of other ideas are kept.
Levels by pairs, six views that refinement does not see (benchmarks/quality.py), cuts of benchmarks/refine.py. An idea is a change
of the modules that learn, made for its run alone.
"""

import argparse
import itertools
import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

import splatree as st
from harness import DATA, RESULTS, save, table
from quality import Judge
from refine import cuts, scores
from splatree.train import lessons, proxies, refine, school

CHUNK = DATA / "trained" / "semarang_city" / "5_1"
CUTS = ("10 % of the leaves", "5 % of the leaves")
DEGREE_ONE = 3.0
"""Σ b² of the harmonics of degree 1, over that of degree 0."""
WEIGHT = 0.3
"""How far harmonics of degree 1 go, where colours go 1."""


class WithHarmonics(proxies.Proxies):
    """Nodes that learn their harmonics of degree 1, by a step that overshoots no more than that of their colours."""

    def __init__(self, scene: st.Scene) -> None:
        super().__init__(scene)
        self.harmonics = scene.gaussians.sh[self.rows][:, 1:4].copy()
        self.first = self.harmonics.copy()

    def draw(self, view, rows):
        drawn = super().draw(view, rows)
        self.drawn.sh[drawn.rows, 1:4] = self.harmonics[drawn.nodes]
        return drawn

    def derivatives(self, drawn, splats, found):
        self.slopes = found.sh[:, 1:4]
        return super().derivatives(drawn, splats, found)

    def paint(self, found, weights, factor):
        share = factor / (1 + WEIGHT * DEGREE_ONE)
        super().paint(found, weights, share)
        length = np.float32(WEIGHT * proxies.PAINTED * share / proxies.SH_C0**2) / (
            weights + np.float32(proxies.LEAST_PX)
        )
        self.harmonics[found.rows] -= length[:, None, None] * self.slopes

    def forget(self, rows):
        super().forget(rows)
        self.harmonics[self._node[rows]] = self.first[self._node[rows]]

    def scene(self):
        scene = super().scene()
        sh = scene.gaussians.sh.copy()
        sh[self.rows, 1:4] = self.harmonics
        return replace(scene, gaussians=replace(scene.gaussians, sh=sh))


def coarse_plan(num_lessons: int, options: st.RefineOptions) -> Iterator[tuple[int, float]]:
    """Cuts that grow more frequent towards the coarsest, in proportion to the logarithm."""
    rng = np.random.default_rng([options.seed, 2])
    while True:
        for lesson in rng.permutation(num_lessons).tolist():
            yield lesson, options.finest * (options.coarsest / options.finest) ** math.sqrt(rng.uniform())


def faster(*names: str) -> Callable[[], object]:
    """Rates of some columns times 2.5."""
    rates = {name: rate * (2.5 if name in names else 1) for name, rate in proxies.RATES.items()}
    return lambda: patch.object(proxies, "RATES", rates)


def lenient() -> object:
    """Nodes go back to what they were only where errors grew by a tenth."""
    times, errors = itertools.count(), school.School.errors
    return patch.object(
        school.School, "errors", lambda self, looked_at: errors(self, looked_at) / (1.1 if next(times) else 1)
    )


IDEAS = {
    "as it is": nullcontext,
    "harmonics of degree 1 learn too": lambda: patch.object(school, "Proxies", WithHarmonics),
    "rates of shapes × 2.5": faster("quats", "log_scales"),
    "rate of opacity × 2.5": faster("logit_opacities"),
    "coarse cuts more often": lambda: patch.object(school, "_plan", coarse_plan),
    "steps shorter below an error of 0.03": lambda: patch.object(school, "WRONG", 0.03),
    "nodes go back only where errors grew by a tenth": lenient,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, default=CHUNK)
    parser.add_argument("ideas", nargs="*")
    parser.add_argument("--steps", type=int, default=1000)
    options = parser.parse_args()
    if unknown := [name for name in options.ideas if name not in IDEAS]:
        parser.error(f"found {', '.join(unknown)}, wanted of: {'; '.join(IDEAS)}")
    leaves = st.read(options.scene)
    tree, judge = st.build_lod(leaves, st.BuildOptions("pairs")), Judge(leaves.gaussians, leaves.mode)
    selections = {name: select for name, select in cuts(leaves.tree.num_leaves).items() if name in CUTS}
    before = {name: scores(judge, tree, select)[0] for name, select in selections.items()}
    pictures: list[lessons.Lesson] = []  # the teacher's are the same for all ideas

    def drawn_once(*given, **more):
        pictures[:] = pictures or lessons.lessons_of(*given, **more)
        return pictures

    for idea in options.ideas or IDEAS:
        with ExitStack() as stack:
            stack.enter_context(patch.object(refine, "lessons_of", drawn_once))
            stack.enter_context(IDEAS[idea]())
            refined = st.refine(tree, st.RefineOptions(iterations=options.steps))
        row = {"scene": options.scene.name, "steps": options.steps, "idea": idea}
        for name, select in selections.items():
            gains = scores(judge, refined.scene, select)[0] - before[name]
            row |= {
                f"{name}, gain dB": round(float(gains.mean()), 2),
                f"{name}, worst dB": round(float(gains.min()), 2),
            }
        print(table([row]), flush=True)
        keep(row)


def keep(row: dict[str, object]) -> None:
    """Keep the row of an idea beside those of the others."""
    path, key = RESULTS / "refine_ideas.json", ("scene", "steps", "idea")
    kept = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [other for other in kept if any(other[name] != row[name] for name in key)] + [row]
    save(
        "refine_ideas",
        rows,
        about="What ideas add to refinement by equal steps, levels by pairs, six views that it does not see.",
    )


if __name__ == "__main__":
    main()
