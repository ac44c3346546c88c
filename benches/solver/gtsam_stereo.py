"""Peer of `cargo run --release -p lsfb-problems --example solve -- stereo`: GTSAM's LM on the stereo factors that it ships, CPU time.

    V/bin/python gtsam_stereo.py FOLDER [SUFFIX]      (files as for the example; virtual environment as in gtsam_pose_graph.py)
"""
import os
import sys
import time

os.environ["OMP_NUM_THREADS"] = os.environ["TBB_NUM_THREADS"] = "1"
import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

folder = sys.argv[1]
suffix = sys.argv[2] if len(sys.argv) > 2 else "00s.txt.gz"
read = lambda name: np.loadtxt(f"{folder}/{name}{suffix}")
camera = gtsam.Cal3_S2Stereo(*np.atleast_1d(read("VO_calibration"))[:6])
poses = {int(r[0]): gtsam.Pose3(r[1:].reshape(4, 4)) for r in read("VO_camera_poses")}
factors = read("VO_stereo_factors")
factors = factors[np.argsort(factors[:, 0], kind="stable")]
pixel = gtsam.noiseModel.Robust.Create(
    gtsam.noiseModel.mEstimator.Huber.Create(1.345), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
)
graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
for i in sorted(poses):
    values.insert(X(i), poses[i])
first = min(poses)
graph.push_back(gtsam.PriorFactorPose3(X(first), poses[first], gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
seen = set()
for r in factors:
    i, j = int(r[0]), int(r[1])
    graph.push_back(gtsam.GenericStereoFactor3D(gtsam.StereoPoint2(*r[2:5]), pixel, X(i), L(j), camera))
    if j not in seen:
        seen.add(j)
        values.insert(L(j), poses[i].transformFrom(gtsam.Point3(*r[5:8])))
began = time.process_time()
optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
result = optimizer.optimize()
print(
    f"gtsam LM: {graph.size()} factors, {len(seen)} points, cost {graph.error(values):.4f} -> {graph.error(result):.6f}, "
    f"{optimizer.iterations()} iterations, cpu {time.process_time() - began:.3f} s"
)
