"""Compiled curves: the shortest by Dubins and by Reeds and Shepp, and points along them. The turning radius is 1.

Kernels that other kernels call stand before them. The formulas are those of the papers that each kernel names.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled

LEFT, STRAIGHT, RIGHT = 1, 0, -1
SEGMENTS = 5  # of the longest word; the rest of a shorter one has length 0
EPSILON = 1e-9  # lengths that rounding has made negative

Curve = NDArray[np.float64]  # (SEGMENTS, 2) kind and length of each segment


@compiled("float64(float64)")
def full_turn(angle: float) -> float:
    """Return the equivalent angle in [0, 2 pi); 0 for one that rounding has put just below 2 pi."""
    angle %= 2 * math.pi
    return 0.0 if angle > 2 * math.pi - EPSILON else angle


@compiled("float64(float64)")
def half_turn(angle: float) -> float:
    """Return the equivalent angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


@compiled("void(float64[:,::1], float64[::1], float64[::1])")
def _keep_shorter(best: Curve, kinds: NDArray[np.float64], lengths: NDArray[np.float64]) -> None:
    if np.abs(lengths).sum() < np.abs(best[:, 1]).sum():
        best[:, 0], best[:, 1] = kinds, lengths


@compiled("float64[:,::1](float64, float64, float64)")
def dubins(x: float, y: float, theta: float) -> Curve:
    """Return the shortest curve without reverse from the origin to a pose.

    Dubins, On Curves of Minimal Length with a Constraint on Average Curvature, 1957; formulas of Shkel and Lumelsky,
    Classification of the Dubins Set, 2001, section 3.
    """
    best = np.full((SEGMENTS, 2), np.inf)
    kinds, lengths = np.zeros(SEGMENTS), np.zeros(SEGMENTS)
    distance, direction = math.hypot(x, y), math.atan2(y, x)
    a, b = full_turn(-direction), full_turn(theta - direction)
    sa, sb, ca, cb, cab = math.sin(a), math.sin(b), math.cos(a), math.cos(b), math.cos(a - b)
    for first in (LEFT, RIGHT):
        # A word that begins to the right is the mirror image of the one that begins to the left.
        m = float(first)
        square = 2 + distance * distance - 2 * cab + m * 2 * distance * (sa - sb)
        if square >= 0:  # LSL, RSR
            angle = math.atan2(cb - ca, distance + m * (sa - sb))
            kinds[:3] = first, STRAIGHT, first
            lengths[:3] = full_turn(-m * a + angle), math.sqrt(square), full_turn(m * b - angle)
            _keep_shorter(best, kinds, lengths)
        square = -2 + distance * distance + 2 * cab + m * 2 * distance * (sa + sb)
        if square >= 0:  # LSR, RSL
            middle = math.sqrt(square)
            angle = math.atan2(-(ca + cb), distance + m * (sa + sb)) - math.atan2(-2.0, middle)
            kinds[:3] = first, STRAIGHT, -first
            lengths[:3] = full_turn(-m * a + angle), middle, full_turn(-m * b + angle)
            _keep_shorter(best, kinds, lengths)
        cosine = (6 - distance * distance + 2 * cab - m * 2 * distance * (sa - sb)) / 8
        if abs(cosine) <= 1:  # LRL, RLR
            middle = full_turn(2 * math.pi - math.acos(cosine))
            turn = full_turn(-m * a + math.atan2(cb - ca, distance + m * (sa - sb)) + middle / 2)
            kinds[:3] = first, -first, first
            lengths[:3] = turn, middle, full_turn(m * (b - a) - turn + middle)
            _keep_shorter(best, kinds, lengths)
    return best


@compiled("UniTuple(float64, 2)(float64, float64, float64, float64, float64)")
def _tau_omega(u: float, v: float, xi: float, eta: float, phi: float) -> tuple[float, float]:
    delta = half_turn(u - v)
    a, b = math.sin(u) - math.sin(delta), math.cos(u) - math.cos(delta) - 1
    angle = math.atan2(eta * a - xi * b, xi * a + eta * b)
    tau = half_turn(angle + math.pi if 2 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3 < 0 else angle)
    return tau, half_turn(tau - u + v - phi)


@compiled("float64[:,::1](int64, float64, float64, float64)")
def _word(formula: int, x: float, y: float, phi: float) -> Curve:
    """Return the curve of one formula of section 8 of Reeds and Shepp, which begins forward and to the left.

    Its lengths are infinite if the formula has no solution.
    """
    curve = np.full((SEGMENTS, 2), np.inf)
    kinds, lengths = curve[:, 0], curve[:, 1]
    xi, eta = x - math.sin(phi), y - 1 + math.cos(phi)  # of words that end to the left
    if formula in (1, 3, 4, 6, 7):  # of those that end to the right
        xi, eta = x + math.sin(phi), y - 1 - math.cos(phi)
    rho, angle = math.hypot(xi, eta), math.atan2(eta, xi)
    quarter = -math.pi / 2
    if formula == 0:  # 8.1, L+ S+ L+
        t, v = angle, half_turn(phi - angle)
        if t >= -EPSILON and v >= -EPSILON:
            kinds[:] = LEFT, STRAIGHT, LEFT, 0, 0
            lengths[:] = t, rho, v, 0.0, 0.0
    elif formula == 1 and rho >= 2:  # 8.2, L+ S+ R+
        u = math.sqrt(rho * rho - 4)
        t = half_turn(angle + math.atan2(2.0, u))
        v = half_turn(t - phi)
        if t >= -EPSILON and v >= -EPSILON:
            kinds[:] = LEFT, STRAIGHT, RIGHT, 0, 0
            lengths[:] = t, u, v, 0.0, 0.0
    elif formula == 2 and rho <= 4:  # 8.3 and 8.4, L+ R- L±
        u = -2 * math.asin(rho / 4)
        t = half_turn(angle + u / 2 + math.pi)
        if t >= -EPSILON:
            kinds[:] = LEFT, RIGHT, LEFT, 0, 0
            lengths[:] = t, u, half_turn(phi - t + u), 0.0, 0.0
    elif formula == 3 and rho <= 2:  # 8.7, L+ R+ L- R-
        u = math.acos((2 + rho) / 4)
        t, v = _tau_omega(u, -u, xi, eta, phi)
        if t >= -EPSILON and v <= EPSILON:
            kinds[:] = LEFT, RIGHT, LEFT, RIGHT, 0
            lengths[:] = t, u, -u, v, 0.0
    elif formula == 4 and 4 <= rho * rho <= 20:  # 8.8, L+ R- L- R+
        u = -math.acos((20 - rho * rho) / 16)
        t, v = _tau_omega(u, u, xi, eta, phi)
        if t >= -EPSILON and v >= -EPSILON:
            kinds[:] = LEFT, RIGHT, LEFT, RIGHT, 0
            lengths[:] = t, u, u, v, 0.0
    elif formula == 5 and rho >= 2:  # 8.9, L+ R- S- L-
        r = math.sqrt(rho * rho - 4)
        t = half_turn(angle + math.atan2(r, -2.0))
        v = half_turn(phi + quarter - t)
        if t >= -EPSILON and v <= EPSILON:
            kinds[:] = LEFT, RIGHT, STRAIGHT, LEFT, 0
            lengths[:] = t, quarter, 2 - r, v, 0.0
    elif formula == 6 and rho >= 2:  # 8.10, L+ R- S- R-
        t = math.atan2(xi, -eta)
        v = half_turn(t - quarter - phi)
        if t >= -EPSILON and v <= EPSILON:
            kinds[:] = LEFT, RIGHT, STRAIGHT, RIGHT, 0
            lengths[:] = t, quarter, 2 - rho, v, 0.0
    elif formula == 7 and rho >= 2:  # 8.11, L+ R- S- L- R+
        u = 4 - math.sqrt(rho * rho - 4)
        if u <= EPSILON:
            t = half_turn(math.atan2((4 - u) * xi - 2 * eta, -2 * xi + (u - 4) * eta))
            v = half_turn(t - phi)
            if t >= -EPSILON and v >= -EPSILON:
                kinds[:] = LEFT, RIGHT, STRAIGHT, LEFT, RIGHT
                lengths[:] = t, quarter, u, quarter, v
    return curve


@compiled("float64[:,::1](float64, float64, float64)")
def reeds_shepp(x: float, y: float, theta: float) -> Curve:
    """Return the shortest curve, forward and in reverse, from the origin to a pose.

    Reeds and Shepp, Optimal Paths for a Car That Goes Both Forwards and Backwards, 1990. Each formula stands for up to
    eight words: driven in reverse, mirrored, and from the goal to the start.
    """
    best = np.full((SEGMENTS, 2), np.inf)
    c, s = math.cos(theta), math.sin(theta)
    for formula in range(8):
        for backwards in range(2 if formula in (2, 5, 6) else 1):
            px, py = (x * c + y * s, x * s - y * c) if backwards else (x, y)
            for drive in (1.0, -1.0):
                for mirror in (1.0, -1.0):
                    curve = _word(formula, drive * px, mirror * py, drive * mirror * theta)
                    if not np.isfinite(curve[0, 1]):
                        continue
                    count = SEGMENTS
                    while count > 3 and curve[count - 1, 1] == 0.0:
                        count -= 1
                    kinds, lengths = np.zeros(SEGMENTS), np.zeros(SEGMENTS)
                    for index in range(count):
                        source = count - 1 - index if backwards else index
                        kinds[index], lengths[index] = mirror * curve[source, 0], drive * curve[source, 1]
                    _keep_shorter(best, kinds, lengths)
    return best


@compiled("UniTuple(float64, 3)(float64, float64, float64, float64, float64)")
def drive(x: float, y: float, theta: float, kind: float, length: float) -> tuple[float, float, float]:
    """Return the pose after a segment, from a pose x, y, theta."""
    if kind == STRAIGHT:
        return x + length * math.cos(theta), y + length * math.sin(theta), theta
    end = theta + kind * length
    return x + kind * (math.sin(end) - math.sin(theta)), y - kind * (math.cos(end) - math.cos(theta)), end


@compiled("float64[:,::1](float64[:,::1], float64, float64, float64, float64, float64)")
def sample(curve: Curve, x: float, y: float, theta: float, radius: float, spacing: float) -> NDArray[np.float64]:
    """Return poses along a curve with their direction of travel.

    Args:
        curve: The curve.
        x: Its start, metres.
        y: Its start, metres.
        theta: Heading at its start, radians.
        radius: Turning radius, metres.
        spacing: Largest distance between neighbours, metres.

    Returns:
        (n, 4) x, y, theta, and 1 forward or -1 in reverse; without the start, and with the ends of all segments.
    """
    count = 0
    for index in range(SEGMENTS):
        count += math.ceil(abs(curve[index, 1]) * radius / spacing)
    poses = np.empty((count, 4))
    at = 0
    for index in range(SEGMENTS):
        length = curve[index, 1]
        steps = math.ceil(abs(length) * radius / spacing)
        ahead = theta
        for step in range(1, steps + 1):
            dx, dy, ahead = drive(0.0, 0.0, theta, curve[index, 0], length * step / steps)
            poses[at, 0], poses[at, 1], poses[at, 2] = x + radius * dx, y + radius * dy, ahead
            poses[at, 3] = 1.0 if length > 0 else -1.0
            at += 1
        if steps:
            x, y, theta = poses[at - 1, 0], poses[at - 1, 1], ahead
    return poses
