"""Peer of `lsfb bench ba`: GTSAM's ISAM2 on the walk that it wrote, keyframe by keyframe.

    V/bin/python isam2_walk.py FOLDER/problem.txt isam2.csv        (environment as in README.md)

Prints one line a keyframe: its number, CPU milliseconds of the update, cost after it (which is not timed).
"""
import os
import sys
import time

os.environ["OMP_NUM_THREADS"] = os.environ["TBB_NUM_THREADS"] = "1"
import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

parameters = gtsam.ISAM2Params()
parameters.setRelinearizeThreshold(0.01)
parameters.relinearizeSkip = 1
isam = gtsam.ISAM2(parameters)
graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
n, seen, known, here, out = 0, set(), {}, None, open(sys.argv[2], "w")
fixed = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
out.write("keyframe,cpu_ms,cost\n")


def update():
    global graph, values, here
    began = time.process_time()
    isam.update(graph, values)
    spent = 1e3 * (time.process_time() - began)
    estimate = isam.calculateEstimate()
    here = estimate.atPose3(X(n - 1))
    out.write(f"{n},{spent:.4f},{isam.getFactorsUnsafe().error(estimate):.9g}\n")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()


for line in open(sys.argv[1]):
    word, *numbers = line.split()
    if word == "#":
        continue
    numbers = [float(x) for x in numbers]
    if word == "camera":
        fx, fy, cx, cy, baseline, huber = numbers
        lens = gtsam.Cal3_S2Stereo(fx, fy, 0, cx, cy, baseline)
        pixel = gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Huber.Create(huber), gtsam.noiseModel.Unit.Create(3)
        )
    elif word == "sigmas":
        first, rotation, translation = numbers
        start = gtsam.noiseModel.Isotropic.Sigma(6, first)
        odometry = gtsam.noiseModel.Diagonal.Sigmas(np.repeat((rotation, translation), 3))
    elif word == "map":
        known[int(numbers[0])] = np.array(numbers[1:])
    elif word == "keyframe":
        if n:
            update()
        x, y, z, w = numbers[:4]
        moved = gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), np.array(numbers[4:7]))
        if n:
            here = here.compose(moved)
            graph.push_back(gtsam.BetweenFactorPose3(X(n - 1), X(n), moved, odometry))
        else:
            here = moved
            graph.push_back(gtsam.PriorFactorPose3(X(0), here, start))
        values.insert(X(n), here)
        n += 1
    elif word == "see":
        point, left, right, row = int(numbers[0]), *numbers[1:]
        if point not in seen and point in known:
            values.insert(L(point), known[point])
            graph.push_back(gtsam.PriorFactorPoint3(L(point), known[point], fixed))
        elif point not in seen:
            depth = fx * baseline / max(left - right, 1.0)
            local = np.array(((left - cx) * depth / fx, (row - cy) * depth / fy, depth))
            values.insert(L(point), here.transformFrom(local))
        seen.add(point)
        measured = gtsam.StereoPoint2(left, right, row)
        graph.push_back(gtsam.GenericStereoFactor3D(measured, pixel, X(n - 1), L(point), lens))
update()
