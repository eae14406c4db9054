"""A chart of quality over what it costs, as SVG: PSNR over the number of nodes, or over bytes."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

__all__ = ["quality_chart"]


def quality_chart(lines: Mapping[str, Sequence[tuple[float, float]]], label: str) -> str:
    """Lines of (cost, dB) by their names, as SVG of 720 × 300; costs on a logarithmic scale. ``label`` says what is shown."""
    shown = {name: [point for point in line if np.isfinite(point[1])] for name, line in lines.items()}
    points = [point for line in shown.values() for point in line]
    if not points:
        return ""
    low_x, high_x = np.log10(min(cost for cost, _ in points)) - 0.15, np.log10(max(cost for cost, _ in points))
    low_y, high_y = np.floor(min(q for _, q in points) / 5) * 5, np.ceil(max(q for _, q in points) / 5) * 5

    def at(cost: float, quality: float) -> tuple[float, float]:
        x = 60 + 640 * (np.log10(cost) - low_x) / max(1e-9, high_x - low_x)
        return x, 260 - 240 * (quality - low_y) / max(1e-9, high_y - low_y)

    parts = []
    for quality in np.arange(low_y, high_y + 1, 5):
        y = at(10**low_x, quality)[1]
        parts.append(f'<line class="grid" x1="60" x2="700" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="52" y="{y + 4:.1f}" text-anchor="end">{quality:.0f}</text>')
    for cost in (n * 10.0**e for e in range(-2, 8) for n in (1, 2, 5)):
        if low_x <= np.log10(cost) <= high_x:
            x = at(cost, low_y)[0]
            parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="20" y2="260"/>')
            parts.append(f'<text x="{x:.1f}" y="278" text-anchor="middle">{cost:,.10g}</text>')
    for i, (name, line) in enumerate(shown.items()):
        places = [at(*point) for point in line]
        color = f"hsl({20 + 220 * i / max(1, len(shown) - 1):.0f} 65% 50%)"
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline fill="none" stroke="{color}" stroke-width="2" points="{path}"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{color}"/>' for x, y in places]
        parts += [f'<text x="{x:.1f}" y="{y - 8:.1f}" text-anchor="end">{escape(name)}</text>' for x, y in places[-1:]]
    return f'<svg viewBox="0 0 720 300" role="img" aria-label="{escape(label)}">' + "".join(parts) + "</svg>"
