"""Values and derivatives that no package gives, from the published formulas in 60 digits; and cameras of SymForce.

Recipe: python3 -m venv v && v/bin/pip install mpmath numpy symforce-sym
        v/bin/python precise.py > precise.txt
One line per value, as in expected.txt. Derivatives are central differences with steps of 1e-20: exact to 1e-39.
"""
import random

import numpy as np
import sym
from mpmath import atan2, binomial, cos, factorial, matrix, mp, mpf, sin, sqrt, tan

mp.dps = 60
STEP = mpf(10) ** -20
random.seed(11)
uniform = lambda low, high: random.uniform(low, high)


def line(kind, source, given, got):
    text = lambda values: " ".join(repr(float(x)) for x in values)
    print(kind, source, text(given), "|", text(got))


def slope(function, at=mpf(0)):
    return (function(at + STEP) - function(at - STEP)) / (2 * STEP)


# Cumulative splines on SO(3): Sommer et al., CVPR 2020, eq. (18)–(20) for the coefficients, (31) for the rotation.
def hat(v):
    return matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def vee(m):
    return matrix([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2


def exp(v):
    angle = sqrt(sum(x * x for x in v))
    if angle == 0:
        return mp.eye(3)
    axis = hat([x / angle for x in v])
    return mp.eye(3) + axis * sin(angle) + axis * axis * (1 - cos(angle))


def log(m):
    v = vee(m)
    sine = sqrt(sum(x * x for x in v))
    return v if sine == 0 else v * (atan2(sine, (m[0, 0] + m[1, 1] + m[2, 2] - 1) / 2) / sine)


def coefficients(order, u):
    blend = lambda s, n: (
        binomial(order - 1, n)
        / factorial(order - 1)
        * sum((-1) ** (l - s) * binomial(order, l - s) * mpf(order - 1 - l) ** (order - 1 - n) for l in range(s, order))
    )
    return [sum(sum(blend(s, n) for s in range(j, order)) * u**n for n in range(order)) for j in range(order)]


def spline(controls, spacing, time):
    weights = coefficients(len(controls), time / spacing)
    rotation = controls[0]
    for j in range(1, len(controls)):
        rotation = rotation * exp(log(controls[j - 1].T * controls[j]) * weights[j])
    return rotation


for order in (4, 5, 6):
    for spread in (0.4, 1.2):
        spacing, fraction = 0.25, uniform(0.05, 0.95)
        vectors = [[uniform(-1, 1) for _ in range(3)]]
        for _ in range(order - 1):
            vectors.append([x + uniform(-spread, spread) for x in vectors[-1]])
        controls = [exp([mpf(x) for x in v]) for v in vectors]
        now = mpf(fraction) * spacing

        def rotation_change(others, time=now):
            return log(spline(controls, spacing, now).T * spline(others, spacing, time))

        def velocity(others, time):
            at = spline(others, spacing, time)
            return slope(lambda t: vee(at.T * spline(others, spacing, t)), time)

        def moved(j, axis, by):
            delta = [mpf(0)] * 3
            delta[axis] = by
            return [c * exp(delta) if k == j else c for k, c in enumerate(controls)]

        got = [*velocity(controls, now), *slope(lambda t: velocity(controls, t), now)]
        for j in range(order):
            for axis in range(3):
                got += [*slope(lambda by: rotation_change(moved(j, axis, by)))]
                got += [*slope(lambda by: velocity(moved(j, axis, by), now))]
        line("spline-rates", f"mpmath{order}", [spacing, fraction, *sum(vectors, [])], got)


# Cameras, as their papers have them; p is x, y, z; k the parameters.
def double_sphere(k, p):  # Usenko et al., 3DV 2018, eq. (40)–(42)
    d1 = sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    d2 = sqrt(p[0] ** 2 + p[1] ** 2 + (k[4] * d1 + p[2]) ** 2)
    depth = k[5] * d2 + (1 - k[5]) * (k[4] * d1 + p[2])
    return [k[0] * p[0] / depth + k[2], k[1] * p[1] / depth + k[3]]


def extended_unified(k, p):  # Khomutenko et al., RA-L 2016, eq. (8)
    depth = k[4] * sqrt(k[5] * (p[0] ** 2 + p[1] ** 2) + p[2] ** 2) + (1 - k[4]) * p[2]
    return [k[0] * p[0] / depth + k[2], k[1] * p[1] / depth + k[3]]


def field_of_view(k, p):  # Devernay and Faugeras 2001, eq. (13)
    radius = sqrt(p[0] ** 2 + p[1] ** 2)
    scale = atan2(2 * radius * tan(k[4] / 2), p[2]) / (k[4] * radius)
    return [k[0] * scale * p[0] + k[2], k[1] * scale * p[1] + k[3]]


def by_mpmath(kind, project, k, p):
    k, p = [mpf(x) for x in k], [mpf(x) for x in p]
    nudged = lambda v, j, by: [x + by if n == j else x for n, x in enumerate(v)]
    by_point = [slope(lambda s: matrix(project(k, nudged(p, j, s)))) for j in range(3)]
    by_parameter = [slope(lambda s: matrix(project(nudged(k, j, s), p))) for j in range(len(k))]
    got = [*project(k, p)]
    for columns in (by_point, by_parameter):
        got += [column[row] for row in (0, 1) for column in columns]
    line(kind, "mpmath", [*k, *p], got)


def by_symforce(kind, camera, k, p):
    pixel, valid, by_cal, by_point = camera.from_storage(k).pixel_from_camera_point_with_jacobians(np.array(p), 1e-14)
    assert valid == 1
    line(kind, "symforce", [*k, *p], [*pixel.ravel(), *np.ravel(by_point), *np.ravel(by_cal)])


# Some of them behind the plane of the lens, where wide lenses still see.
points = [[uniform(-0.8, 0.8), uniform(-0.6, 0.6), uniform(0.3, 1.4)] for _ in range(10)]
points += [[uniform(0.9, 1.4), uniform(-1, 1), uniform(-0.3, 0.1)] for _ in range(4)]
for k in ([350, 352, 321, 198.5, -0.2, 0.59], [310, 309, 318, 240, 0.25, 0.66], [290, 291, 322, 239, 0.8, 0.3]):
    for p in points:
        by_mpmath("double-sphere", double_sphere, k, p)
        if p[2] > 0:
            by_symforce("double-sphere", sym.DoubleSphereCameraCal, k, p)
for k in ([300, 301, 321, 198.5, 0.62, 1.1], [280, 281, 322, 239, 0.48, 0.8]):
    for p in points:
        if p[2] > 0 or k[4] > 0.5:
            by_mpmath("extended-unified", extended_unified, k, p)
for k in ([256, 257, 321, 198.5, 0.92], [200, 201, 318, 240, 1.4]):
    for p in points:
        by_mpmath("field-of-view", field_of_view, k, p)
        if p[2] > 0:
            by_symforce("field-of-view", sym.ATANCameraCal, k, p)
