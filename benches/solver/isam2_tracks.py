"""Peer of `cargo run --release -p lsfb-pipeline --example incremental_tracks`: GTSAM's ISAM2 on the same stereo tracks, with the
same factors, weights and first values; CPU time of its updates and error of its keyframes.

    V/bin/python isam2_tracks.py FOLDER        (the unpacked vi_tracks_seq90.tar.gz; environment as in README.md)
"""
import glob
import os
import struct
import sys
import time

os.environ["OMP_NUM_THREADS"] = os.environ["TBB_NUM_THREADS"] = "1"
import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

FOCAL, BEGIN = 458.0, 1403636579.763555584
SIGHT = struct.Struct("<i2f4fB3x")


class Reader:
    def __init__(self, path):
        self.bytes, self.at = open(path, "rb").read(), 0

    def int(self):
        self.at += 4
        return struct.unpack_from("<i", self.bytes, self.at - 4)[0]

    def floats(self, n):
        self.at += 4 * n
        return np.frombuffer(self.bytes, "<f4", n, self.at - 4 * n).astype(float)

    def line(self):
        self.at = self.bytes.index(b"\n", self.at) + 1

    def sights(self):
        n = self.int()
        self.at += SIGHT.size * n
        rows = SIGHT.iter_unpack(self.bytes[self.at - SIGHT.size * n : self.at])
        return [(r[0], r[1], r[2], r[7]) for r in rows]


def frame(path):
    r = Reader(path)
    r.int(), r.floats(21), r.sights()
    n = r.int()
    imu, when = r.floats(7 * n).reshape(n, 7), r.floats(1)[0]
    r.floats(2), r.line(), r.line()
    if r.int() < 0:
        return imu, when, None
    r.floats(12)
    sights = r.sights()
    for _ in range(r.int()):
        of_point, point = r.sights(), r.int()
        r.floats(3)
        sights += [(point, *s[1:]) for s in of_point]
    return imu, when, sights


def undistorted(k, pixels):
    y = (np.array(pixels).reshape(-1, 2) - k[2:4]) / k[:2]
    x = y.copy()
    for _ in range(50):
        s = (x * x).sum(axis=1)[:, None]
        cross = x[:, :1] * x[:, 1:]
        tangential = np.hstack(
            (2 * k[6] * cross + k[7] * (s + 2 * x[:, :1] ** 2), k[6] * (s + 2 * x[:, 1:] ** 2) + 2 * k[7] * cross)
        )
        x = (y - tangential) / (1 + k[4] * s + k[5] * s * s)
    return x


def pose(rows):
    u, _, v = np.linalg.svd(rows[:, :3])
    return gtsam.Pose3(gtsam.Rot3(u @ v), rows[:, 3])


calibration = np.frombuffer(open(f"{sys.argv[1]}/calibration.dat", "rb").read(), "<f4", offset=12).astype(float)
left = pose(calibration[:12].reshape(3, 4)).inverse()
left_from_right = pose(calibration[30:42].reshape(3, 4))
sides = (left, left.compose(left_from_right))
lenses = (calibration[18:30], calibration[42:54])
frames = [frame(path) for path in sorted(glob.glob(f"{sys.argv[1]}/dat/*.dat"))]
pinhole = gtsam.Cal3_S2(FOCAL, FOCAL, 0, 0, 0)
pixel = gtsam.noiseModel.Robust.Create(
    gtsam.noiseModel.mEstimator.Huber.Create(1.345), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
)
imu_noise = gtsam.PreintegrationParams.MakeSharedU(9.81)
imu_noise.setAccelerometerCovariance(np.eye(3) * 4e-3**2)
imu_noise.setGyroscopeCovariance(np.eye(3) * 3.4e-4**2)
imu_noise.setIntegrationCovariance(np.eye(3) * 1e-8)
wander = gtsam.noiseModel.Diagonal.Sigmas(np.repeat((3e-3, 2e-4), 3))
parameters = gtsam.ISAM2Params()
parameters.setRelinearizeThreshold(0.05)
parameters.relinearizeSkip = 1
isam = gtsam.ISAM2(parameters)

up = np.vstack([imu for imu, _, _ in frames[:2]])[:, :3].mean(axis=0)
up /= np.linalg.norm(up)
axis = np.cross(up, (0, 0, 1))
upright = gtsam.Rot3.AxisAngle(axis / np.linalg.norm(axis), np.arctan2(np.linalg.norm(axis), up[2]))
here, velocity, bias = gtsam.Pose3(upright, np.zeros(3)), np.zeros(3), gtsam.imuBias.ConstantBias()
pending, seen, spent, times, live = [], set(), [], [], []
for imu, when, sights in frames:
    pending.append(imu)
    if sights is None:
        continue
    n, graph, values = len(times), gtsam.NonlinearFactorGraph(), gtsam.Values()
    if n == 0:
        sigmas = np.array((0.05, 0.05, 0.001, 1e-3, 1e-3, 1e-3))
        graph.push_back(gtsam.PriorFactorPose3(X(0), here, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
        graph.push_back(gtsam.PriorFactorVector(V(0), velocity, gtsam.noiseModel.Isotropic.Sigma(3, 0.05)))
        known = gtsam.noiseModel.Diagonal.Sigmas(np.repeat((0.2, 0.1), 3))
        graph.push_back(gtsam.PriorFactorConstantBias(B(0), bias, known))
    else:
        sums = gtsam.PreintegratedImuMeasurements(imu_noise, bias)
        samples = np.vstack(pending)
        for sample, dt in zip(samples, np.diff(np.append(samples[:, 6], when))):
            if dt > 0:
                sums.integrateMeasurement(sample[:3], sample[3:6], dt)
        graph.push_back(gtsam.ImuFactor(X(n - 1), V(n - 1), X(n), V(n), B(n - 1), sums))
        graph.push_back(gtsam.BetweenFactorConstantBias(B(n - 1), B(n), gtsam.imuBias.ConstantBias(), wander))
        state = sums.predict(gtsam.NavState(here, velocity), bias)
        here, velocity = state.pose(), state.velocity()
    pending = []
    values.insert(X(n), here), values.insert(V(n), velocity), values.insert(B(n), bias)
    by_side = []
    for side in (0, 1):
        of_side = [s for s in sights if s[3] == side]
        rays = undistorted(lenses[side], [s[1:3] for s in of_side])
        by_side.append({s[0]: ray for s, ray in zip(of_side, rays)})
    for point, ray in by_side[0].items():
        other = by_side[1].get(point)
        if point not in seen:
            if other is None:
                continue
            a = np.append(ray, 1)
            rays = np.c_[a, -left_from_right.rotation().matrix() @ np.append(other, 1)]
            depth = np.linalg.lstsq(rays, left_from_right.translation(), rcond=None)[0][0]
            if not 0.2 < depth < 15:
                continue
            begun = here.compose(left).transformFrom(a * depth)
            values.insert(L(point), begun)
            seen.add(point)
            graph.push_back(gtsam.PriorFactorPoint3(L(point), begun, gtsam.noiseModel.Isotropic.Sigma(3, 3.0)))
        for seen_by, where in zip((ray, other), sides):
            if seen_by is not None:
                factor = gtsam.GenericProjectionFactorCal3_S2(seen_by * FOCAL, pixel, X(n), L(point), pinhole, where)
                graph.push_back(factor)
    began = time.process_time()
    isam.update(graph, values)
    isam.update()
    spent.append(1e3 * (time.process_time() - began))
    here, velocity = isam.calculateEstimatePose3(X(n)), isam.calculateEstimateVector(V(n))
    bias = isam.calculateEstimateConstantBias(B(n))
    times.append(BEGIN + when)
    live.append(here.translation())

truth = np.loadtxt(f"{sys.argv[1]}/gt_tum.txt")


def ate(points):
    points = np.array(points)
    known = np.stack([np.interp(times, truth[:, 0], truth[:, k]) for k in (1, 2, 3)], axis=1)
    a, b = points - points.mean(axis=0), known - known.mean(axis=0)
    u, _, v = np.linalg.svd(b.T @ a)
    turn = u @ np.diag((1, 1, np.linalg.det(u @ v))) @ v
    return np.sqrt(((a @ turn.T - b) ** 2).sum(axis=1).mean())


estimate = isam.calculateEstimate()
print(
    f"gtsam ISAM2: {len(times)} keyframes, cpu {sum(spent):.0f} ms in all, median {np.median(spent):.2f}, "
    f"p95 {np.percentile(spent, 95):.2f}, most {max(spent):.2f} ms per keyframe"
)
print(
    f"ATE of keyframes {100 * ate([estimate.atPose3(X(k)).translation() for k in range(len(times))]):.2f} cm at the end, "
    f"{100 * ate(live):.2f} cm as each was when it was new"
)
graph = isam.getFactorsUnsafe()
optimum = gtsam.LevenbergMarquardtOptimizer(graph, estimate).optimize()
above = graph.error(estimate) / graph.error(optimum) - 1
print(f"cost {graph.error(estimate):.4f}, {above:.1e} above that of a batch solve from there")
