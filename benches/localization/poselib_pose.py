"""The pose search beside PoseLib's, on the same points, one thread each, taking turns.

Usage: poselib_pose.py PROGRAM [OUTLIERS [POINTS]]

PROGRAM is target/release/examples/pose_search. Needs numpy and poselib (2.0.5). A hundred problems of POINTS points (500), a share of OUTLIERS
(0.5) of them anywhere, the others with a noise of 1 px; both are given the same limit (4 px), numbers of samples and probability.
"""

import subprocess
import sys
import tempfile
import time

import numpy as np
import poselib

program = sys.argv[1]
outliers = float(sys.argv[2]) if len(sys.argv) > 2 else 0.5
points = int(sys.argv[3]) if len(sys.argv) > 3 else 500
COUNT, TURNS = 100, 3
WIDTH, HEIGHT, FX, FY, CX, CY = 752, 480, 458.0, 457.0, 367.0, 248.0


def rotation(vector):
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def problem(seed):
    random = np.random.default_rng(seed)
    r, t = rotation(random.normal(size=3) * 0.4), random.normal(size=3)
    # What the camera sees, up to 15 m away.
    pixels = np.c_[random.uniform(0, WIDTH, points), random.uniform(0, HEIGHT, points)]
    depth = random.uniform(3, 15, points)
    seen = np.c_[(pixels - [CX, CY]) / [FX, FY], np.ones(points)] * depth[:, None]
    pixels = pixels + random.normal(size=(points, 2))
    wrong = int(points * outliers)
    pixels[:wrong] = np.c_[random.uniform(0, WIDTH, wrong), random.uniform(0, HEIGHT, wrong)]
    return pixels, (seen - t) @ r, -r.T @ t


problems = [problem(seed) for seed in range(COUNT)]
camera = {"model": "PINHOLE", "width": WIDTH, "height": HEIGHT, "params": [FX, FY, CX, CY]}
options = {"max_reproj_error": 4.0, "max_iterations": 1000, "min_iterations": 100, "success_prob": 0.9999}


def peer_turn():
    times, errors = [], []
    for pixels, world, centre in problems:
        spent = []
        for _ in range(5):
            begun = time.thread_time()
            pose, _ = poselib.estimate_absolute_pose(pixels, world, camera, options, {})
            spent.append(time.thread_time() - begun)
        times.append(np.median(spent) * 1e3)
        errors.append(np.linalg.norm(-pose.R.T @ pose.t - centre))
    return np.array(times), np.array(errors)


def our_turn(file):
    out = subprocess.run([program, file], capture_output=True, text=True, check=True).stdout
    rows = np.array([[float(v) for v in line.split()] for line in out.splitlines()])
    return rows[:, 0], np.linalg.norm(rows[:, 2:] - [p[2] for p in problems], axis=1)


with tempfile.NamedTemporaryFile() as file:
    head = np.array([COUNT, points, WIDTH, HEIGHT, FX, FY, CX, CY], "<f8")
    rows = [np.c_[pixels, world] for pixels, world, _ in problems]
    file.write(head.tobytes() + np.ascontiguousarray(rows, "<f8").tobytes())
    file.flush()
    for _ in range(TURNS):
        for name, (times, errors) in [("poselib", peer_turn()), ("ours", our_turn(file.name))]:
            print(
                f"{name:8} {np.median(times):.3f} ms, mean {times.mean():.3f}; error {np.median(errors) * 1e3:.2f} mm, "
                f"of ten nine within {np.quantile(errors, 0.9) * 1e3:.2f}, largest {errors.max() * 1e3:.2f}",
                flush=True,
            )
