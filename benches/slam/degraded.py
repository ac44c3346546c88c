"""A trajectory as a worse SLAM would give it: drift of position, heading and scale, a random walk with a seed.

    python3 degraded.py scan.tum --out worse.tum --seed 1 --percent 2.5 --degrees-per-metre 0.15

Poses are TUM lines. The motion from pose to pose is made longer or shorter and turned by errors that wander over some metres, so that distances over
ten metres are off by some per cent (the paper's SLAM: 31.6 cm on average over 8 to 17 m).
"""

import argparse

import numpy as np


def rotation(q):
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(r):
    w = np.sqrt(max(0.0, 1 + r[0, 0] + r[1, 1] + r[2, 2])) / 2
    if w > 0.1:
        return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 4 * w * w]) / (4 * w)
    values, vectors = np.linalg.eigh(
        np.array(
            [
                [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
                [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
                [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
                [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
            ]
        )
    )
    return vectors[:, np.argmax(values)]


def about(axis):
    angle = np.linalg.norm(axis)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = axis / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("tum")
    arguments.add_argument("--out", required=True)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--percent", type=float, default=2.5, help="1 sigma of the errors of scale and of motion to the side")
    arguments.add_argument("--degrees-per-metre", type=float, default=0.15, help="1 sigma of the errors of heading")
    arguments.add_argument("--wander-m", type=float, default=5.0, help="way over which errors change")
    a = arguments.parse_args()
    rows = [line.split() for line in open(a.tum) if line.strip() and not line.startswith("#")]
    places = np.array([[float(v) for v in row[1:4]] for row in rows])
    turns = [rotation(np.array([float(v) for v in row[4:8]])) for row in rows]
    dice = np.random.default_rng(a.seed)
    # Errors that wander: first-order Gauss-Markov along the way.
    error = dice.standard_normal(4)
    place, turn = places[0], turns[0]
    with open(a.out, "w") as out:
        for i, row in enumerate(rows):
            if i > 0:
                moved = turns[i - 1].T @ (places[i] - places[i - 1])
                way = np.linalg.norm(moved)
                kept = np.exp(-way / a.wander_m)
                error = kept * error + np.sqrt(1 - kept * kept) * dice.standard_normal(4)
                share = a.percent / 100
                # Longer or shorter, and to the side and upwards.
                moved = moved * (1 + share * error[0]) + way * share * np.array([0, error[1], 0.3 * error[2]])
                yaw = np.radians(a.degrees_per_metre) * way * error[3]
                place = place + turn @ moved
                turn = about(np.array([0, 0, yaw])) @ turn @ (turns[i - 1].T @ turns[i])
            q = quaternion(turn)
            print(row[0], *(f"{v:.9f}" for v in place), *(f"{v:.12f}" for v in q), file=out)


main()
