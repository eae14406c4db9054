"""Inner nodes as things that learn: what of them changes, how they are drawn, and what is stored of them afterwards.

A node keeps its mean and its harmonics above degree 0. It learns its colour and its opacity. Where the selection takes its size
from the extent (profile `sphere`), it also learns its shape. Where the selection looks at the shape itself (`exact`), the stored
shape stays, and so does the mass of a node that is more than one Gaussian, which widens it: the same nodes are small in every
view, before and after.

A node with a curve (lod/follow.py) is drawn by its mass G at the dilation h of its depth. It learns the factor s = eᵃ of that
mass at all depths, and its variances v as they are without widening:

    G(h) = √(m² + b h + (n h)²) / A(v, h),    opacity min(0.99, G),    variances w v + (w − 1) h,  w = max(1, G / 0.99)^0.3

with m, n and g times s, and m and n also times A(v, h_l) / A(v₀, h_l), so that a new shape has the mass of the old one. Then

    ∂loss/∂a = (G < 0.99) H + Σ_k (∂loss/∂ln σ_k) 0.15 w (v_k + h) / σ_k²,     ∂loss/∂ln √v_k = (∂loss/∂ln σ_k) w v_k / σ_k²

for the σ that are drawn and H = ∂loss/∂ln opacity; of the shape, by ln √v also through ln A(v, h_l) − ln A(v, h). A node
without a curve learns its logit and its scales as they are.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatree.constants import ALPHA_MAX, SH_C0
from splatree.scene.frame import Splats
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments
from splatree.scene.names import EXTENT_PROFILES
from splatree.scene.scene import Scene
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float32, Int32

__all__ = ["Drawn", "Proxies"]

RATES = {"quats": 8e-3, "log_scales": 4e-2, "logit_opacities": 0.2}
"""At the beginning of a run, of a node that has made `RAMP_STEPS` (train/school.py); means do not move."""

PAINTED = 0.3
"""Share of the way that a colour goes at the beginning of a run. With 0.7 a city gains 0.05 dB more at a tenth of its leaves, but
the nearest view of few nodes loses 0.3 dB."""

LEAST_PX = 1.0
"""Added to the pixels that a node covers: colours of nodes that cover less hardly move."""

OPACITY_MIN = 1e-6


@dataclass(frozen=True, eq=False)
class Drawn:
    """Inner nodes as they are drawn in one view."""

    rows: Int32[Array, "d"]
    """Their rows, ascending."""
    nodes: Int32[Array, "d"]
    """Their places among the inner nodes."""
    by_mass: Float32[Array, "d"]
    """Derivative of ln opacity by a, over that by the logit: 0 where the opacity is held at 0.99."""
    by_width: Float32[Array, "d 3"]
    """Derivative of ln σ by a."""
    by_shape: Float32[Array, "d 3"]
    """Derivative of ln σ by ln √v."""
    by_area: Float32[Array, "d 3"]
    """Derivative of ln mass by ln √v."""


class Proxies:
    """The inner nodes of a scene; arrays change as they learn."""

    def __init__(self, scene: Scene) -> None:
        self._scene, tree, g = scene, scene.tree, scene.gaussians
        self.rows = np.flatnonzero(~tree.is_leaf).astype(np.int32)
        self._node = np.full(len(scene), -1, np.int32)
        self._node[self.rows] = np.arange(len(self.rows))
        self._learns_shape = tree.record is not None and tree.record.profile in EXTENT_PROFILES
        curves = np.zeros((len(scene), 4), np.float32) if tree.curves is None else tree.curves
        self._curves = curves[self.rows] if scene.mode == "classic" else np.zeros((len(self.rows), 4), np.float32)
        self._has_curve = self._curves[:, 2] > 0
        _, _, peak, level = self._curves.T
        stored = np.exp(2 * g.log_scales[self.rows].astype(np.float64))
        wide = _widening(peak)[:, None]
        bare = np.maximum(stored - (wide - 1) * level[:, None], 1e-24) / wide
        self._area = _area(bare, level).astype(np.float32)
        logits = np.where(self._has_curve, np.float32(0), g.logit_opacities[self.rows])
        self.learned = Gaussians(
            np.zeros((len(self.rows), 3), np.float32),
            g.quats[self.rows],
            (0.5 * np.log(bare)).astype(np.float32),
            logits.astype(np.float32),
            np.ascontiguousarray(g.sh[self.rows][:, :1]),
        )
        # A mass beyond one Gaussian widens what is stored, so where shapes stay it neither passes that nor changes there.
        room = np.log(ALPHA_MAX / np.maximum(peak, 1e-37))
        free = np.inf * np.ones_like(room)
        self._bounds = np.where(
            self._has_curve, np.stack([np.where(room > 0, -free, 0), np.maximum(room, 0)]), np.stack([-free, free])
        ).astype(np.float32)
        self._first = Gaussians(*(column.copy() for column in _columns(self.learned)))
        self.moments = Moments.zeros(len(self.rows), 1)
        # What is drawn: leaves as they are, inner nodes as the last view left them.
        self.drawn = Gaussians(g.means, *(column.copy() for column in _columns(g)[1:]))

    def rates(self, factor: float) -> Float32[Array, "e"]:
        """Of the numbers of a node, in the order of `Moments.values`."""
        shape = float(self._learns_shape)
        rates = np.zeros(self.moments.values.shape[2], np.float32)
        rates[3:7], rates[7:10] = shape * RATES["quats"], shape * RATES["log_scales"]
        rates[10] = RATES["logit_opacities"]
        return rates * np.float32(factor)

    def draw(self, view: View, rows: Int32[Array, "v"]) -> Drawn:
        """Write the inner nodes among some rows into `drawn`, as they look in a view."""
        nodes = self._node[rows]
        rows, nodes = rows[nodes >= 0], nodes[nodes >= 0]
        pose, K = view.camera.camera_from_world, view.camera.K
        depths = self.drawn.means[rows].astype(np.float64) @ pose[2, :3] + pose[2, 3]
        h = (view.dilation_px2 * depths**2 / (K[0, 0] * K[1, 1])).astype(np.float32)
        has_curve, learned, drawn = self._has_curve[nodes], self.learned, self.drawn
        if not self._learns_shape:
            learned.logit_opacities[nodes] = np.clip(learned.logit_opacities[nodes], *self._bounds[:, nodes])
        m, n, peak, level, v = self._at(nodes)
        h = np.minimum(h, level)
        b = np.maximum((peak * _area(v, level)) ** 2 - m**2 - (n * level) ** 2, 0) / np.maximum(level, 1e-37)
        mass = np.minimum(np.sqrt(m * m + b * h + (n * h) ** 2) / _area(v, h), peak)
        wide = _widening(mass)[:, None]
        squares = wide * v + (wide - 1) * h[:, None]
        opacities = np.clip(mass, OPACITY_MIN, ALPHA_MAX)
        logits = np.log(opacities / (1 - opacities))
        own = learned.log_scales[nodes]
        drawn.log_scales[rows] = np.where(has_curve[:, None], 0.5 * np.log(squares), own)
        drawn.logit_opacities[rows] = np.where(has_curve, logits, learned.logit_opacities[nodes])
        drawn.quats[rows], drawn.sh[rows, 0] = learned.quats[nodes], learned.sh[nodes, 0]
        by_mass = np.where(mass < ALPHA_MAX, 1 / (1 - opacities), 0)
        # Masses are in proportion to A(v, h_l) / A(v, h); at the peak they no longer follow v.
        by_area = np.where((mass < peak)[:, None], _area_slopes(v, level) - _area_slopes(v, h), 0)
        by_width = np.where(wide > 1, 0.15 * wide * (v + h[:, None]) / squares, 0)
        return Drawn(
            rows,
            nodes,
            np.where(has_curve, by_mass, 1).astype(np.float32),
            np.where(has_curve[:, None], by_width, 0).astype(np.float32),
            np.where(has_curve[:, None], wide * v / squares, 1).astype(np.float32),
            np.where(has_curve[:, None], by_area, 0).astype(np.float32),
        )

    def _at(self, nodes: Array) -> tuple[Array, Array, Array, Array, Array]:
        """m, n, g, h_l and the variances of nodes as they have been learned."""
        m, n, peak, level = self._curves[nodes].T
        factor = np.exp(np.where(self._has_curve[nodes], self.learned.logit_opacities[nodes], 0))
        v = np.exp(2 * self.learned.log_scales[nodes])
        ratio = factor * _area(v, level) / self._area[nodes]
        return m * ratio, n * ratio, peak * factor, level, v

    def derivatives(self, drawn: Drawn, splats: Splats, found: GaussianGradients) -> GaussianGradients:
        """By what the nodes learn, from the derivatives by what was drawn of the splats."""
        at = np.searchsorted(drawn.rows, splats.rows)
        mass = found.logit_opacities * drawn.by_mass[at] + np.sum(found.log_scales * drawn.by_width[at], axis=1)
        return GaussianGradients(
            drawn.nodes[at],
            np.zeros_like(found.means),
            found.quats,
            found.log_scales * drawn.by_shape[at] + mass[:, None].astype(np.float32) * drawn.by_area[at],
            mass.astype(np.float32),
            np.ascontiguousarray(found.sh[:, :1]),
        )

    def paint(self, found: GaussianGradients, weights: Float32[Array, "d"], factor: float) -> None:
        """Move the colours of nodes towards what the teacher shows in a view.

        A picture is linear in the colours: X = Σ w c with Σ w ≤ 1 in each pixel. So no step c ← c − Σ w (X − Y) / Σ w of all
        nodes at once overshoots: the matrix WᵀW of the normal equations, its rows divided by Σ w, has no eigenvalue above 1,
        since the sum of its row i is Σ w_i Σ_j w_j ≤ Σ w_i. Here it is shorter: by `PAINTED` times the factor.

        Args:
            found: derivatives of ½ Σ |X − Y|².
            weights: Σ w of each node, px.
            factor: of this step.
        """
        length = np.float32(min(1.0, PAINTED * factor) / SH_C0**2) / (weights + np.float32(LEAST_PX))
        step = length[:, None] * found.sh[:, 0]
        self.learned.sh[found.rows, 0] -= np.where(np.isfinite(step), step, np.float32(0))

    def shapes(self, nodes: Int32[Array, "d"]) -> tuple[Array, ...]:
        """Opacities and shapes of nodes, copied."""
        return tuple(column[nodes] for column in self._shapes())

    def hold_back(self, nodes: Int32[Array, "d"], before: tuple[Array, ...], share: Float32[Array, "d"]) -> None:
        """Let opacities and shapes of nodes go but a share of the way from what they were before."""
        for column, old in zip(self._shapes(), before, strict=True):
            column[nodes] = old + share.reshape((-1,) + (1,) * (old.ndim - 1)) * (column[nodes] - old)

    def _shapes(self) -> tuple[Array, ...]:
        return self.learned.quats, self.learned.log_scales, self.learned.logit_opacities

    def is_node(self, rows: Array) -> Bool[Array, "v"]:
        """Whether rows are inner nodes."""
        return np.asarray(self._node[rows] >= 0)

    def forget(self, rows: Array) -> None:
        """Let inner nodes be what they were."""
        nodes = self._node[rows]
        for column, first in zip(_columns(self.learned), _columns(self._first), strict=True):
            column[nodes] = first[nodes]

    def arrays(self) -> dict[str, Array]:
        """All that learning goes on from: what inner nodes have become, and the moments of the optimiser."""
        return {**vars(self.learned), "moments": self.moments.values, "steps": self.moments.steps}

    def go_on(self, learned: Gaussians, moments: Moments) -> None:
        """Let inner nodes be what they had become when an earlier run stopped."""
        self.learned, self.moments = learned, moments

    def scene(self) -> Scene:
        """The scene with what was learned. Nodes that learned nothing keep their bits; leaves and the tree are the same."""
        differs = np.zeros(len(self.rows), bool)
        for column, first in zip(_columns(self.learned), _columns(self._first), strict=True):
            differs |= (column != first).reshape(len(self.rows), -1).any(axis=1)
        nodes = np.flatnonzero(differs)
        rows, g, tree = self.rows[nodes], self._scene.gaussians, self._scene.tree
        columns = dict(zip(("means", "quats", "log_scales", "logit_opacities", "sh"), _columns(g), strict=True))
        for name in ("quats", "log_scales", "logit_opacities", "sh"):
            columns[name] = columns[name].copy()
        m, n, peak, level, v = self._at(nodes)
        has_curve = self._has_curve[nodes]
        wide = _widening(peak)[:, None]
        opacities = np.clip(peak, OPACITY_MIN, ALPHA_MAX)
        if self._learns_shape:
            stored = 0.5 * np.log(wide * v + (wide - 1) * level[:, None])
            columns["log_scales"][rows] = np.where(has_curve[:, None], stored, self.learned.log_scales[nodes])
        columns["logit_opacities"][rows] = np.where(
            has_curve, np.log(opacities / (1 - opacities)), self.learned.logit_opacities[nodes]
        )
        columns["quats"][rows], columns["sh"][rows, 0] = self.learned.quats[nodes], self.learned.sh[nodes, 0]
        curves = tree.curves
        if curves is not None and has_curve.any():
            curves = curves.copy()
            curves[rows[has_curve]] = np.stack([m, n, peak, level], axis=1)[has_curve]
        return replace(
            self._scene, gaussians=Gaussians(**columns), tree=replace(tree, curves=curves), blocks=None, clusters=None
        )


def _columns(g: Gaussians) -> tuple[Array, ...]:
    return g.means, g.quats, g.log_scales, g.logit_opacities, g.sh


def _widening(mass: Array) -> Array:
    return np.asarray(np.maximum(mass / np.float32(ALPHA_MAX), 1) ** np.float32(0.3))


def _area(variances: Array, dilations: Array) -> Array:
    x, y, z = np.sqrt(variances.T + dilations)
    return np.asarray(np.maximum((x * y + y * z + x * z) / 3, np.float32(1e-37)))


def _area_slopes(variances: Array, dilations: Array) -> Array:
    """Derivatives of ln A by ln √v along each axis."""
    axes = np.sqrt(variances + dilations[:, None])
    others = axes.sum(axis=1, keepdims=True) - axes
    return np.asarray(others * variances / (3 * axes * _area(variances, dilations)[:, None]))
