"""What a view loses by shrinking that `calibrate` has not drawn: `--policy worst` against views that were kept back.

``python benchmarks/held_out.py`` needs the shared scenes. Of each, 48 views at 320 × 180 px are drawn with τ = 0.2, balanced,
and their losses are measured as `calibrate` does it. Of these, n are taken at random, 400 times: how often does another view
lose more than the worst of the n, and how much more does the worst of all others lose? Chance alone says that one other view
is worse than n with probability 1 / (n + 1). *margin*: the same against a bound that adds the difference of the two worst
(Robson and Whitlock 1964).
"""

import math

import numpy as np

import splatree as st
from harness import save, table
from promise import SCENES

THRESHOLD = 0.2
TRIALS = 400


def main() -> None:
    rng = np.random.default_rng(0)
    rows: list[dict[str, object]] = []
    for name in ("city 5_9", "logo", "biker"):
        scene = st.read(SCENES[name])
        options = st.PathOptions(views=16, width=320, height=180)
        around = st.turn(st.frame_scene(scene), options)
        losses = losses_of(scene, [*st.flyout(scene, options), *st.orbit(scene, options), *around])
        for n in (4, 8, 16, 24):
            shares, ratios, bounds = [], [], []
            for _ in range(TRIALS):
                order = rng.permutation(losses)
                second, worst = np.sort(order[:n])[-2:]
                shares.append(float(np.mean(order[n:] > worst)))
                ratios.append(order[n:].max() / worst)
                bounds.append(order[n:].max() / (2 * worst - second))
            rows.append(
                {"scene": name, "views drawn": n, "worst of all, dB": float(losses.max())}
                | {"other views that lose more": float(np.mean(shares)), "1 / (n + 1)": 1 / (n + 1)}
                | {"worst other / worst drawn, median": float(np.median(ratios))}
                | {"of 20, the worst": float(np.quantile(ratios, 0.95))}
                | {"with a margin, median": float(np.median(bounds)), "of 20": float(np.quantile(bounds, 0.95))}
            )
    print(table(rows))
    save("held_out", rows, about="What views lose by shrinking that were not drawn, against the worst that was")


def losses_of(scene: st.Scene, views: list[st.Camera]) -> np.ndarray:
    """Loss of each view, dB."""
    losses = []
    with st.open_session(scene, select=st.SelectOptions(pixel_error=0.0)) as session:
        for view in views:
            ways = (st.RenderOptions(threshold=1 / 255), st.RenderOptions(threshold=THRESHOLD, tile_rule="balanced"))
            lossless, shrunk = (np.clip(session.draw(view, options=way).image, 0, 1) for way in ways)
            losses.append(10 * math.log10(1 + 10 ** ((30 - min(st.psnr(shrunk, lossless), 120.0)) / 10)))
    return np.array(losses)


if __name__ == "__main__":
    main()
