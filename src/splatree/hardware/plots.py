"""Plots of the report as SVG text: stacked bars, time lines, curves. No library: the page opens anywhere, without a network."""

import math
from collections.abc import Mapping, Sequence
from html import escape

from splatree.hardware.simulate import Span

__all__ = ["COLORS", "bars", "curves", "time_line"]

COLORS = ("#2f6fab", "#e08a2e", "#4f9d69", "#b5484b", "#7b62a3", "#8c6d4f", "#c77cb5", "#8a8d91", "#b9a832", "#3aa6a8")
WIDTH = 860


def bars(rows: Mapping[str, Mapping[str, float]], unit: str) -> str:
    """Stacked bars, one a row, on one scale, with a legend.

    Args:
        rows: parts by name of each bar.
        unit: unit of the values.
    """
    names = list(dict.fromkeys(name for parts in rows.values() for name in parts))
    color = {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}
    largest = max((sum(parts.values()) for parts in rows.values()), default=0) or 1.0
    left, scale = 190, (WIDTH - 290) / largest
    out, y = [], 8
    for label, parts in rows.items():
        out.append(_text(left - 8, y + 15, label, "end"))
        x = float(left)
        for name, value in parts.items():
            title = f"<title>{escape(name)}: {value:.4g} {escape(unit)}</title>"
            out.append(
                f'<rect x="{x:.1f}" y="{y}" width="{value * scale:.2f}" height="20" fill="{color[name]}">{title}</rect>'
            )
            x += value * scale
        out.append(_text(x + 6, y + 15, f"{sum(parts.values()):.4g} {unit}"))
        y += 28
    x = float(left)
    for name in names:
        out.append(f'<rect x="{x:.0f}" y="{y + 4}" width="11" height="11" fill="{color[name]}"/>')
        out.append(_text(x + 15, y + 14, name))
        x += 34 + 7.2 * len(name)
        if x > WIDTH - 120:
            x, y = float(left), y + 20
    return _svg(y + 26, out)


def time_line(spans: Sequence[Span], cycles: int) -> str:
    """Stretches of work, a lane for each engine, over the cycles from 0 to ``cycles`` (Jo 2024, Fig. 8)."""
    lanes = list(dict.fromkeys(span.unit for span in spans))
    left, scale = 110, (WIDTH - 130) / max(cycles, 1)
    out = []
    for i, lane in enumerate(lanes):
        y = 8 + 30 * i
        out.append(_text(left - 8, y + 16, lane, "end"))
        out.append(f'<rect x="{left}" y="{y}" width="{WIDTH - 130}" height="22" fill="#8882"/>')
        for n, span in enumerate([s for s in spans if s.unit == lane and s.begin < cycles]):
            width = max((min(span.end, cycles) - span.begin) * scale, 0.4)
            shade = COLORS[i % len(COLORS)]
            out.append(
                f'<rect x="{left + span.begin * scale:.2f}" y="{y}" width="{width:.2f}" height="22" fill="{shade}" '
                f'opacity="{1 if n % 2 else 0.75}"><title>cycles {span.begin:,} to {span.end:,}</title></rect>'
            )
    y = 8 + 30 * len(lanes)
    out += [_text(left, y + 14, "cycle 0"), _text(WIDTH - 20, y + 14, f"{cycles:,}", "end")]
    return _svg(y + 22, out)


def curves(
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    x_label: str,
    y_label: str,
    *,
    log: bool = False,
    points: Sequence[str] = (),
) -> str:
    """Curves over one pair of axes; those named in ``points`` are drawn as dots. ``log``: both axes are logarithmic."""

    def along(value: float) -> float:
        return math.log10(max(value, 1e-30)) if log else value

    xs = [along(x) for line in lines.values() for x in line[0]]
    ys = [along(y) for line in lines.values() for y in line[1]]
    low_x, high_x = min(xs), max(xs)
    low_y, high_y = (min(ys), max(ys)) if log else (0.0, max(ys))
    left, top, width, height = 80, 12, WIDTH - 240, 260

    def place(x: float, y: float) -> tuple[float, float]:
        across = (along(x) - low_x) / ((high_x - low_x) or 1)
        up = (along(y) - low_y) / ((high_y - low_y) or 1)
        return left + across * width, top + (1 - up) * height

    out = [f'<rect x="{left}" y="{top}" width="{width}" height="{height}" fill="none" stroke="#8888"/>']
    for i, (name, (x, y)) in enumerate(lines.items()):
        color, at = COLORS[i % len(COLORS)], [place(*pair) for pair in zip(x, y, strict=True)]
        if name not in points:
            path = " ".join(f"{a:.1f},{b:.1f}" for a, b in at)
            out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        out += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3.5" fill="{color}"/>' for a, b in at]
        out.append(f'<rect x="{left + width + 14}" y="{top + 20 * i}" width="11" height="11" fill="{color}"/>')
        out.append(_text(left + width + 30, top + 10 + 20 * i, name))
    ends = [10**v if log else v for v in (low_x, high_x, low_y, high_y)]
    out += [
        _text(left, top + height + 18, f"{ends[0]:.4g}"),
        _text(left + width, top + height + 18, f"{ends[1]:.4g}", "end"),
    ]
    out += [_text(left - 6, top + height, f"{ends[2]:.4g}", "end"), _text(left - 6, top + 10, f"{ends[3]:.4g}", "end")]
    out.append(_text(left + width / 2, top + height + 18, x_label, "middle"))
    out.append(_text(left + 6, top + 14, y_label))
    return _svg(top + height + 28, out)


def _text(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _svg(height: float, parts: Sequence[str]) -> str:
    return f'<svg viewBox="0 0 {WIDTH} {height:.0f}" width="100%" role="img">{"".join(parts)}</svg>'
