"""What shrinking costs and saves: PSNR against the pairs of splat and tile, for every rule, on real scenes in one run.

Rules: the squares of 3DGS (`3sigma`) and of FilterGS (`tau`, with τ by its paper's formula, by its code's, and over a range), and
our ellipses, of one τ or balanced by area, with pixels drawn whole (`hard`) or tapered off, over the same range, and with the τ
found by `calibrate` for 0.1 dB.
PSNR is that of the mean squared error against the lossless picture; pairs are relative to `3sigma`. Then the cost of measuring
contributions, and the CPU time of each stage, on one thread.

``python benchmarks/shrinking.py`` (the city, playbot and logo need ../shared/data; the bundled block does not); ``--quick`` takes
the bundled block only and keeps no results; ``--picture FILE.png`` only draws where a large τ loses what.
"""

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import splatree as st
from harness import DATA, ROOT, save, table
from splatree.kernels.cpu import frame as cpu
from splatree.scene.options import RenderOptions

THRESHOLDS = (1 / 255, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3)
LAMBDA_G = 0.2
BUDGET_DB = 0.1
WIDTH = 960
LEAVES = st.SelectOptions(pixel_error=0)
BUNDLED = ROOT / "src" / "splatree" / "data" / "semarang_5_9.sog"


@dataclass(frozen=True)
class Subject:
    """A scene and the views that it is drawn from."""

    name: str
    scene: st.Scene
    views: tuple[st.Camera, ...]
    select: st.SelectOptions


@dataclass(frozen=True)
class Drawn:
    """What a rule makes of all views."""

    pairs: int
    error: float
    """Mean squared error against the lossless pictures."""

    @property
    def psnr(self) -> float:
        return -10 * math.log10(self.error) if self.error else math.inf


def main() -> None:
    if "--picture" in sys.argv:
        return draw_losses(sys.argv[sys.argv.index("--picture") + 1])
    quick = "--quick" in sys.argv
    rows: list[dict[str, Any]] = []
    for subject in subjects(quick):
        found = frontier_rows(subject)
        goals = goal_rows(subject, found)
        stages = stage_rows(subject)
        for part in (found, goals, stages):
            print(f"\n{table(part)}", flush=True)
        rows += [*found, *goals, *stages]
    about = (
        "Pairs relative to the squares of 3DGS, PSNR (dB) against the lossless picture, for the published rules and ours; what "
        "measuring contributions costs; CPU-milliseconds of each stage of a frame on one thread."
    )
    if not quick:
        save("shrinking", rows, about=about)


def subjects(quick: bool) -> list[Subject]:
    """The scenes that are there."""
    block = st.read(BUNDLED)
    block_views = around(block, 3)
    found = [Subject("bundled block, levels of detail", st.build_lod(block), block_views, st.SelectOptions())]
    if quick:
        return found
    if not (DATA / "trained").is_dir():
        print("city, playbot, logo: not measured, need ../shared/data")
        return found
    cameras = list(st.read_cameras(DATA / "cameras" / "semarang_city_made_views.json"))[::6]
    views = tuple(camera.scaled(WIDTH / camera.width) for camera in cameras)
    city = st.read([str(DATA / "trained" / "semarang_city" / f"5_{i}") for i in (4, 5, 9)])
    found.append(Subject("three chunks of the city, leaves", city, views, LEAVES))
    for name in ("playbot", "playcanvas_logo"):
        scene = st.read(DATA / "trained" / name)
        found.append(Subject(f"{name}, leaves", scene, around(scene, 3), LEAVES))
    return found


def around(scene: st.Scene, views: int) -> tuple[st.Camera, ...]:
    """Views on a circle and on a flight away, half of each."""
    path = st.PathOptions(views=views, width=WIDTH, height=WIDTH * 9 // 16)
    return (*st.orbit(scene, path), *st.flyout(scene, path))


def draw(subject: Subject, options: RenderOptions, lossless: Sequence[np.ndarray]) -> Drawn:
    """Draw all views by a rule."""
    pairs, errors = 0, []
    for view, wanted in zip(subject.views, lossless, strict=True):
        frame = st.trace(subject.scene, view, options, subject.select)
        pairs += frame.bins.num_pairs
        errors.append(float(np.mean((np.clip(frame.result.image, 0, 1).astype(np.float64) - wanted) ** 2)))
    return Drawn(pairs, float(np.mean(errors)))


def frontier_rows(subject: Subject) -> list[dict[str, Any]]:
    """A line for each rule and τ."""
    lossless = [
        np.clip(st.render(subject.scene, v, RenderOptions(threshold=1 / 255), subject.select).image, 0, 1)
        for v in subject.views
    ]
    squares = draw(subject, RenderOptions(tile_rule="3sigma"), lossless)
    rows = []

    def add(rule: str, options: RenderOptions, policy: str = "range") -> None:
        drawn = draw(subject, options, lossless)
        rows.append(
            {
                "scene": subject.name,
                "rule": rule,
                "policy": policy,
                "τ": options.threshold if options.tile_rule != "3sigma" else "",
                "pairs": drawn.pairs,
                "of 3sigma": drawn.pairs / squares.pairs,
                "PSNR": drawn.psnr,
            }
        )

    add("3sigma", RenderOptions(tile_rule="3sigma"), "3DGS")
    for policy in ("paper", "release"):
        asked = st.CalibrateOptions(policy=policy, lambda_g=LAMBDA_G, lists="3sigma")
        tau = st.calibrate(
            subject.scene, subject.views, asked, RenderOptions(tile_rule="tau"), subject.select
        ).threshold
        add("tau", RenderOptions(tile_rule="tau", threshold=tau), f"{policy}, λ_G {LAMBDA_G}")
    ours = [
        RenderOptions(tile_rule=tile_rule, pixels=pixels)
        for tile_rule in ("ellipse", "balanced")
        for pixels in ("hard", "taper")
    ]
    for options in ours:
        asked = st.CalibrateOptions(loss_db=BUDGET_DB)
        tau = st.calibrate(subject.scene, subject.views, asked, options, subject.select).threshold
        add(f"{options.tile_rule} {options.pixels}", replace(options, threshold=tau), f"target, {BUDGET_DB} dB")
    for tau in THRESHOLDS:
        add("tau", RenderOptions(tile_rule="tau", threshold=tau))
        for options in ours:
            if tau > 1 / 255 or options.pixels == "hard":
                add(f"{options.tile_rule} {options.pixels}", replace(options, threshold=tau))
    return rows


def goal_rows(subject: Subject, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The figures that the frontier was drawn for, each with its goal."""
    by = {(row["rule"], row["policy"], row["τ"]): row for row in rows}
    lossless = by["balanced hard", "range", 1 / 255]
    squares = next(row for row in rows if row["rule"] == "3sigma")
    target = next(row for row in rows if row["rule"] == "balanced hard" and row["policy"].startswith("target"))
    ours = sorted((row["PSNR"], row["of 3sigma"]) for row in rows if row["rule"] == "balanced hard")
    finite = [point for point in ours if point[0] < math.inf]
    top = max(squares["PSNR"], *(row["PSNR"] for row in rows if row["rule"] == "tau")) + 10
    psnrs, pairs = np.array([*finite, (top, lossless["of 3sigma"])]).T  # what is above the last is the lossless list
    theirs = [row for row in rows if row["rule"] in ("tau", "3sigma") and psnrs[0] <= row["PSNR"] < math.inf]
    worst = max(float(np.interp(row["PSNR"], psnrs, pairs)) / row["of 3sigma"] for row in theirs)
    gtc, kpc, kpc_blend = contribution_costs(subject)
    figures = [
        ("ellipse at 1/255: pairs of 3sigma", lossless["of 3sigma"], "≤ 0.75"),
        ("3sigma: PSNR to it, dB", squares["PSNR"], "> 70"),
        (f"target {BUDGET_DB} dB: pairs of 3sigma", target["of 3sigma"], "≤ 0.6"),
        ("ours: pairs of tau or 3sigma at equal PSNR, worst", worst, "< 1"),
        ("GTC: share of the frame", gtc, "≤ 0.15"),
        ("KPC: frame with it over frame", kpc, "≤ 2"),
        ("KPC: blend with it over blend", kpc_blend, ""),
    ]
    return [{"scene": subject.name, "figure": name, "value": value, "goal": goal} for name, value, goal in figures]


def contribution_costs(subject: Subject) -> tuple[float, float, float]:
    """CPU time of GTC over that of the frame, of a frame with KPC over the frame, of a blend with KPC over the blend."""
    view, select = subject.views[0], subject.select
    options = RenderOptions(threshold=1 / 255)
    frame = st.trace(subject.scene, view, options, select, threads=1)

    def blend(contributions: bool) -> float:
        wanted = replace(frame.view, wanted=st.Wanted(contributions=contributions))
        return cheapest_ms(lambda: cpu.blend.blend(frame.splats, frame.bins, wanted, threads=1))

    whole = cheapest_ms(lambda: st.trace(subject.scene, view, options, select, threads=1))
    plain, asked = blend(False), blend(True)
    return cheapest_ms(lambda: st.tile_contributions(frame)) / whole, (whole + asked - plain) / whole, asked / plain


def stage_rows(subject: Subject) -> list[dict[str, Any]]:
    """CPU time of each stage by each rule, summed over the views."""
    view_target = st.calibrate(
        subject.scene, subject.views, st.CalibrateOptions(loss_db=BUDGET_DB), None, subject.select
    )
    rules = {
        "3sigma": RenderOptions(tile_rule="3sigma"),
        "ellipse, 1/255": RenderOptions(threshold=1 / 255),
        f"balanced hard, {BUDGET_DB} dB": RenderOptions(threshold=view_target.threshold, tile_rule="balanced"),
        f"balanced taper, τ of hard at {BUDGET_DB} dB": RenderOptions(
            threshold=view_target.threshold, tile_rule="balanced", pixels="taper"
        ),
    }
    rows = []
    for name, options in rules.items():
        each = [stages_of(subject, view, options) for view in subject.views]
        total = {stage: sum(costs[stage] for costs in each) for stage in each[0]}
        whole = sum(total.values())
        rows.append(
            {"scene": subject.name, "stages of": name, **{f"{stage} ms": ms for stage, ms in total.items()}}
            | {"sum ms": whole}
            | {f"{stage} share": ms / whole for stage, ms in total.items()}
        )
    return rows


def stages_of(subject: Subject, view: st.Camera, options: RenderOptions) -> dict[str, float]:
    """CPU-milliseconds of the stages of a frame."""
    scene = subject.scene
    frame = st.trace(scene, view, options, subject.select)
    rows = frame.selection.rows
    stages: dict[str, Callable[[], Any]] = {
        "project and order": lambda: cpu.project.project(scene.gaussians, scene.ids, rows, frame.view, threads=1),
        "bin": lambda: cpu.bin.bin(frame.splats, frame.view, threads=1),
        "blend": lambda: cpu.blend.blend(frame.splats, frame.bins, frame.view, threads=1),
    }
    return {stage: cheapest_ms(work, repeat=3) for stage, work in stages.items()}


def draw_losses(path: str) -> None:
    """A part of the bundled block at τ = 0.2: drawn hard and tapered, and below, three times what each differs from lossless."""
    scene = st.read(BUNDLED)
    view = st.flyout(scene, st.PathOptions(views=3))[0]
    part = np.s_[250:400, 330:560]
    lossless = st.render(scene, view, select=LEAVES).image[part]
    drawn = [
        st.render(scene, view, RenderOptions(threshold=0.2, pixels=pixels), LEAVES).image[part]
        for pixels in ("hard", "taper")
    ]
    panels = np.vstack([np.hstack(drawn), np.hstack([0.5 + 3 * (image - lossless) for image in drawn])])
    st.write_image(np.clip(panels, 0, 1).repeat(2, axis=0).repeat(2, axis=1), path, force=True)


def cheapest_ms(work: Callable[[], Any], repeat: int = 5) -> float:
    """CPU-milliseconds, the cheapest of several runs after one to warm up."""
    work()
    spent = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return 1e3 * min(spent)


if __name__ == "__main__":
    main()
