"""The demo's chart: quality over nodes drawn, one line a distance, as SVG."""

from collections.abc import Sequence

import numpy as np

from splatree.cli.flight import DemoView


def quality_chart(views: Sequence[DemoView]) -> str:
    """Quality over nodes drawn, one line a distance, as SVG of 720 × 300."""
    points = [(nodes, quality) for view in views for _, nodes, quality in view.curve if np.isfinite(quality)]
    if not points:
        return ""
    low_x, high_x = np.log10(max(1, min(n for n, _ in points))) - 0.15, np.log10(max(2, *(n for n, _ in points)))
    low_y, high_y = np.floor(min(q for _, q in points) / 5) * 5, np.ceil(max(q for _, q in points) / 5) * 5

    def at(nodes: float, quality: float) -> tuple[float, float]:
        x = 60 + 640 * (np.log10(max(1, nodes)) - low_x) / max(1e-9, high_x - low_x)
        return x, 260 - 240 * (quality - low_y) / max(1e-9, high_y - low_y)

    parts = []
    for quality in np.arange(low_y, high_y + 1, 5):
        y = at(10**low_x, quality)[1]
        parts.append(f'<line class="grid" x1="60" x2="700" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="52" y="{y + 4:.1f}" text-anchor="end">{quality:.0f}</text>')
    for nodes in (n * 10**e for e in range(7) for n in (1, 2, 5)):
        if low_x <= np.log10(nodes) <= high_x:
            x = at(nodes, low_y)[0]
            parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="20" y2="260"/>')
            parts.append(f'<text x="{x:.1f}" y="278" text-anchor="middle">{nodes:,}</text>')
    for i, view in enumerate(views):
        line = [at(nodes, quality) for _, nodes, quality in view.curve if np.isfinite(quality)]
        color = f"hsl({20 + 220 * i / max(1, len(views) - 1):.0f} 65% 50%)"
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in line)
        parts.append(f'<polyline fill="none" stroke="{color}" stroke-width="2" points="{path}"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{color}"/>' for x, y in line]
        parts += [
            f'<text x="{x - 8:.1f}" y="{y + 4:.1f}" text-anchor="end">{view.distance:,.0f}</text>' for x, y in line[-1:]
        ]
    return '<svg viewBox="0 0 720 300" role="img" aria-label="PSNR over nodes drawn">' + "".join(parts) + "</svg>"
