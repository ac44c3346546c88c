"""Writes a pose graph on a torus in g2o format: a walk that winds round it, with odometry along the walk and loops
between neighbouring windings; the vertices begin where odometry alone puts them.

    V/bin/python torus.py FILE.g2o [WINDINGS] [POSES_PER_WINDING]
"""
import sys

import numpy as np


def hat(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def rotation(w):
    angle = np.linalg.norm(w)
    if angle < 1e-12:
        return np.eye(3)
    k = hat(w / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def quaternion(r):
    w = np.sqrt(max(0.0, 1 + np.trace(r))) / 2
    if w < 0.1:
        values, vectors = np.linalg.eigh(
            np.array(
                [
                    [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
                    [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
                    [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
                    [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
                ]
            )
        )
        return vectors[:, -1]
    return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 4 * w * w]) / (4 * w)


def main():
    path = sys.argv[1]
    windings = int(sys.argv[2]) if len(sys.argv) > 2 else 50
    per = int(sys.argv[3]) if len(sys.argv) > 3 else 60
    rng = np.random.default_rng(1)
    sigma_t, sigma_r = 0.03, 0.01
    truth = []
    for k in range(windings * per):
        small, large = 2 * np.pi * k / per, 2 * np.pi * k / (windings * per)
        place = lambda a, b: np.array([(8 + 3 * np.cos(a)) * np.cos(b), (8 + 3 * np.cos(a)) * np.sin(b), 3 * np.sin(a)])
        p = place(small, large)
        forward = place(small + 1e-5, large + 1e-5 / windings) - p
        forward /= np.linalg.norm(forward)
        up = np.array([np.cos(small) * np.cos(large), np.cos(small) * np.sin(large), np.sin(small)])
        up -= forward * (up @ forward)
        up /= np.linalg.norm(up)
        truth.append((np.stack([forward, np.cross(up, forward), up], 1), p))
    pairs = [(k, k + 1) for k in range(len(truth) - 1)]
    pairs += [(k, k + per + d) for k in range(len(truth) - per - 1) for d in (-1, 0) if rng.random() < 0.5]
    pairs += [(k, len(truth) - per + k) for k in range(per)]
    edges = []
    for a, b in pairs:
        (ra, ta), (rb, tb) = truth[a], truth[b]
        edges.append((a, b, ra.T @ rb @ rotation(rng.normal(0, sigma_r, 3)), ra.T @ (tb - ta) + rng.normal(0, sigma_t, 3)))
    poses = [truth[0]]
    for _, _, r, t in edges[: len(truth) - 1]:
        ra, ta = poses[-1]
        poses.append((ra @ r, ra @ t + ta))
    it, ir = 1 / sigma_t**2, 1 / sigma_r**2
    upper = [([it] * 3 + [ir] * 3)[r] if r == c else 0 for r in range(6) for c in range(r, 6)]
    line = lambda r, t: " ".join("%.9g" % x for x in (*t, *quaternion(r)))
    with open(path, "w") as file:
        for k, (r, t) in enumerate(poses):
            file.write(f"VERTEX_SE3:QUAT {k} {line(r, t)}\n")
        for a, b, r, t in edges:
            file.write(f"EDGE_SE3:QUAT {a} {b} {line(r, t)} {' '.join('%.9g' % x for x in upper)}\n")
    print(len(poses), "poses", len(edges), "edges")


main()
