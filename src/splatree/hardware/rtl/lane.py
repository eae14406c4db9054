"""A lane of step 1 in Amaranth: a Gaussian enters in each cycle, and leaves as a splat if the picture is in reach.

`rtl.projection` says what it computes. The whole pipeline stands still while a splat finds nobody who takes it.
"""

from collections.abc import Sequence
from typing import Any

from amaranth import Array, Cat, Const, Module, Mux, Signal, signed, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from splatree.hardware.rtl import projection as p
from splatree.hardware.rtl.pipeline import Pipeline, Value

__all__ = ["GaussianLayout", "Lane", "LaneViewLayout", "SplatLayout"]

NUMBER_BITS = 16
"""Bits of a Gaussian's number in the buffer."""
DEPTH_BITS = 44

GaussianLayout = data.StructLayout(
    {
        "number": unsigned(NUMBER_BITS),
        "center": data.ArrayLayout(signed(p.COORDINATE_BITS), 3),
        "quat": data.ArrayLayout(signed(p.QUAT_BITS), 4),
        "scales": data.ArrayLayout(unsigned(p.SCALE_BITS), 3),
        "exponent": signed(p.EXPONENT_BITS),
    }
)
"""A Gaussian at the input."""

LaneViewLayout = data.StructLayout(
    {
        "weights": data.ArrayLayout(data.ArrayLayout(signed(p.WEIGHT_BITS), 3), 3),
        "offsets": data.ArrayLayout(signed(p.OFFSET_BITS), 3),
        "near": unsigned(p.COORDINATE_BITS),
        "focals": data.ArrayLayout(unsigned(p.FOCAL_BITS - 1), 2),
        "centers": data.ArrayLayout(signed(p.PX_BITS), 2),
        "size": data.ArrayLayout(unsigned(16), 2),
        "held": data.ArrayLayout(data.ArrayLayout(signed(p.HELD_BITS), 2), 2),
        "gains": data.ArrayLayout(unsigned(p.GAIN_BITS), 2),
        "exponent": signed(p.EXPONENT_BITS),
        "dilation": unsigned(p.PX_PLACES + 8),
        "reach": unsigned(p.REACH_BITS),
    }
)
"""A view; it must not change while Gaussians are in the pipeline."""

SplatLayout = data.StructLayout(
    {
        "number": unsigned(NUMBER_BITS),
        "depth": signed(DEPTH_BITS),
        "mean_px": data.ArrayLayout(signed(p.PX_BITS), 2),
        "variances": data.ArrayLayout(signed(p.VARIANCE_BITS), 3),
    }
)
"""A splat at the output."""


class Lane(wiring.Component):  # type: ignore[misc]  # Amaranth has no types
    """Takes Gaussians, and hands on the splats that the picture is in reach of, in order."""

    gaussians: In(stream.Signature(GaussianLayout))  # type: ignore[valid-type]
    view: In(LaneViewLayout)  # type: ignore[valid-type]
    splats: Out(stream.Signature(SplatLayout))  # type: ignore[valid-type]

    def elaborate(self, platform: object) -> Module:
        """Build the circuit."""
        m = Module()
        advances = Signal()
        pipe = Pipeline(m, advances)
        given, view = self.gaussians.payload, self.view
        number, exponent = Value(given.number, 0), Value(given.exponent, 0)
        is_given = Value(self.gaussians.valid, 0)
        center = [Value(given.center[i], 0) for i in range(3)]
        scales = [Value(given.scales[i], 0) for i in range(3)]

        t = [_dot(pipe, [view.weights[row][i] for i in range(3)], center, view.offsets[row]) for row in range(3)]
        in_front = pipe.step(lambda z: z > (view.near << p.WEIGHT_PLACES), t[2])
        lift, reciprocal, lifted = _divided(pipe, t)
        shift = pipe.step(lambda e, up: e + view.exponent - up - p.K_PLACES, exponent, lift)
        rotation = _rotation(pipe, [Value(given.quat[i], 0) for i in range(4)])
        rotation_columns = list(zip(*rotation, strict=True))

        means_px, rows = [], []
        for a in range(2):
            slope = pipe.step(lambda x, r: _held_in(x * r >> 24, p.SLOPE_BITS), lifted[a], reciprocal)
            means_px.append(_position(pipe, slope, view.focals[a], view.centers[a]))
            axis = _axis(pipe, slope, view.held[a], view.weights[a], view.weights[2])
            gain = pipe.step(lambda r, focal=view.gains[a]: focal * r >> 20, reciprocal)
            rows.append([_row(pipe, axis, rotation_columns[k], scales[k], gain, shift) for k in range(3)])
        variances = [
            pipe.step(lambda s, d=d: (s >> p.PX_PLACES) + d, _dot_values(pipe, rows[i], rows[j]))
            for i, j, d in ((0, 0, view.dilation), (0, 1, Const(0)), (1, 1, view.dilation))
        ]
        near_enough = [_in_reach(pipe, means_px[a], variances[2 * a], view.size[a], view.reach) for a in range(2)]
        is_kept = pipe.step(lambda *all_of: Cat(*all_of).all(), is_given, in_front, *near_enough)

        last = is_kept.stage
        depth = pipe.step(lambda z: (z >> 8).as_signed(), t[2])
        payload = self.splats.payload
        m.d.comb += [
            advances.eq(~is_kept.signal | self.splats.ready),
            self.gaussians.ready.eq(advances),
            self.splats.valid.eq(is_kept.signal),
            payload.number.eq(pipe.at(number, last)),
            payload.depth.eq(pipe.at(depth, last)),
            *(payload.mean_px[a].eq(pipe.at(means_px[a], last)) for a in range(2)),
            *(payload.variances[i].eq(pipe.at(variances[i], last)) for i in range(3)),
        ]
        return m


def _divided(pipe: Pipeline, t: Sequence[Value]) -> tuple[Value, Value, list[Value]]:
    """The lift of z, its reciprocal, and x and y lifted with it."""
    z = pipe.step(lambda z: Mux(z > 0, z, 1).as_unsigned(), t[2])

    def highest(bits: Any) -> Any:
        top: Any = Const(0, 6)
        for i in range(1, len(bits)):
            top = Mux(bits[i], Const(i, 6), top)
        return top

    top = pipe.step(highest, z)
    lift = pipe.step(lambda top: top - 23, top)
    mantissa = pipe.step(lambda z, top: (z << 23 >> top)[:24], z, top)
    lifted = [pipe.step(lambda x, top: _held_in(x << 23 >> top, 32), t[a], top) for a in range(2)]
    table = Array(Const(int(r), p.TABLE_PLACES + 1) for r in p.RECIPROCALS)
    guess = pipe.step(lambda mantissa: table[mantissa[15:23]], mantissa)
    product = pipe.step(lambda mantissa, guess: mantissa * guess, mantissa, guess)
    error = pipe.step(lambda product: ((1 << 34) - product >> 14)[:13].as_signed(), product)
    correction = pipe.step(lambda guess, error: guess * error >> 12, guess, error)
    reciprocal = pipe.step(
        lambda guess, correction: ((guess << 8) + correction)[: p.RECIPROCAL_PLACES + 1].as_unsigned(),
        guess,
        correction,
    )
    return lift, reciprocal, lifted


def _position(pipe: Pipeline, slope: Value, focal: Any, center: Any) -> Value:
    places = p.SLOPE_PLACES + p.FOCAL_PLACES - p.PX_PLACES
    from_center = pipe.step(lambda s: s * focal >> places, slope)
    return pipe.step(lambda x: _held_in(x + center, p.PX_BITS), from_center)


def _axis(pipe: Pipeline, slope: Value, held: Any, along: Sequence[Any], forward: Sequence[Any]) -> list[Value]:
    """A row of the Jacobian on the camera's axes, without the focal length over z."""
    inside = pipe.step(lambda s: _between(s >> p.SLOPE_PLACES - p.HELD_PLACES, held[0], held[1]), slope)
    return [pipe.step(lambda s, i=i: along[i] - (s * forward[i] >> p.HELD_PLACES), inside) for i in range(3)]


def _rotation(pipe: Pipeline, quat: Sequence[Value]) -> list[list[Value]]:
    w, x, y, z = quat

    def times(a: Value, b: Value) -> Value:
        return pipe.step(lambda a, b: a * b, a, b)

    xx, yy, zz, xy, xz, yz = times(x, x), times(y, y), times(z, z), times(x, y), times(x, z), times(y, z)
    wx, wy, wz = times(w, x), times(w, y), times(w, z)
    places = 2 * p.QUAT_PLACES - 1 - p.WEIGHT_PLACES

    def plus(a: Value, b: Value) -> Value:
        return pipe.step(lambda a, b: a + b >> places, a, b)

    def minus(a: Value, b: Value) -> Value:
        return pipe.step(lambda a, b: a - b >> places, a, b)

    def rest(a: Value, b: Value) -> Value:
        return pipe.step(lambda a, b: (1 << p.WEIGHT_PLACES) - (a + b >> places), a, b)

    return [
        [rest(yy, zz), minus(xy, wz), plus(xz, wy)],
        [plus(xy, wz), rest(xx, zz), minus(yz, wx)],
        [minus(xz, wy), plus(yz, wx), rest(xx, yy)],
    ]


def _row(
    pipe: Pipeline, axis: Sequence[Value], column: Sequence[Value], scale: Value, gain: Value, shift: Value
) -> Value:
    """One number of a row of M."""
    turned = pipe.step(lambda s: s >> p.WEIGHT_PLACES, _dot_values(pipe, axis, column))
    scaled = pipe.step(lambda t, s: t * s >> 14, turned, scale)
    K = pipe.step(lambda s, g: s * g, scaled, gain)

    def placed(K: Any, shift: Any) -> Any:
        up = Mux(shift > p.ROW_BITS, p.ROW_BITS, shift)[:5].as_unsigned()
        down = Mux(shift < -62, 62, -shift)[:6].as_unsigned()
        return _held_in(Mux(shift < 0, K >> down, K << up), p.ROW_BITS)

    return pipe.step(placed, K, shift)


def _in_reach(pipe: Pipeline, mean: Value, variance: Value, size: Any, reach: Any) -> Value:
    def beyond(mean: Any) -> Any:
        before, after = -mean, mean - (size << p.PX_PLACES)
        farther = (Mux(before > after, before, after) >> 8) - 16
        return Mux(farther > 0, farther, 0).as_unsigned()

    distance = pipe.step(beyond, mean)
    squared = pipe.step(lambda d: d * d << p.REACH_PLACES, distance)
    reached = pipe.step(lambda v: reach * ((v >> 4) + 16), variance)
    return pipe.step(lambda d, r: d <= r, squared, reached)


def _dot(pipe: Pipeline, weights: Sequence[Any], values: Sequence[Value], offset: Any) -> Value:
    products = [pipe.step(lambda v, w=w: v * w, value) for value, w in zip(values, weights, strict=True)]
    first = pipe.step(lambda a, b: a + b, products[0], products[1])
    return pipe.step(lambda a, b: a + b + offset, first, products[2])


def _dot_values(pipe: Pipeline, left: Sequence[Value], right: Sequence[Value]) -> Value:
    products = [pipe.step(lambda a, b: a * b, a, b) for a, b in zip(left, right, strict=True)]
    return pipe.step(lambda a, b: a + b, pipe.step(lambda a, b: a + b, products[0], products[1]), products[2])


def _held_in(value: Any, bits: int) -> Any:
    largest = (1 << bits - 1) - 1
    return _between(value, Const(-largest - 1, signed(bits)), Const(largest, signed(bits)))[:bits].as_signed()


def _between(value: Any, low: Any, high: Any) -> Any:
    return Mux(value < low, low, Mux(value > high, high, value))
