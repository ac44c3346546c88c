"""The simulated LiDAR judged by others: packets decoded by PyPI velodyne-decoder, rays cast by Embree.

usage: lidar.py FOLDER          what `packets FOLDER` wrote

Every decoded point is put back on its ray, from the true pose at the point's own time; Embree says where that ray, and
four at the corners of the beam, meet the surfaces. Points whose whole beam lies on one surface, and that met nothing else
within the distance at which the sensor tells surfaces apart, must be off that surface by the noise configured. All others
(at edges, or with a pane close in front of a wall) must lie between the surfaces that their beam met.
"""

import json
import os
import sys

import numpy as np
import velodyne_decoder as vd
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import kstest

folder = sys.argv[1]


def load(name, dtype, columns):
    values = np.fromfile(os.path.join(folder, name), dtype=dtype)
    return values.reshape(-1, columns) if columns > 1 else values


triangles = load("triangles.f32", "<f4", 9).reshape(-1, 3, 3)
normals = load("normals.f32", "<f4", 3)
glass = load("glass.u8", "u1", 1) > 0
scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, np.ascontiguousarray(triangles))
path = np.loadtxt(os.path.join(folder, "world_from_lidar.txt"), dtype=str)
pose_ns = path[:, 0].astype(np.int64)
path = path[:, 1:].astype(float)
turn = Slerp(pose_ns - pose_ns[0], Rotation.from_quat(path[:, 3:]))

# The decoder puts the origin of a beam off the sensor's axis (`z += f tan(-elevation)`); the twin does not.
OPTICAL_CENTRE_M = {"vlp32c": 0.0424, "vlp16": 0.04191}
ELEVATIONS_DEG = {
    "vlp32c": sorted(
        [-25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667, -4]
        + [-4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333]
    ),
    "vlp16": list(range(-15, 16, 2)),
}


def surfaces(origins, rays, reach):
    """Distances at which each ray meets surfaces, up to and with the first that is no glass; NaN beyond."""
    found = np.full((len(rays), 8), np.nan)
    count = np.zeros(len(rays), int)
    travelled = np.zeros(len(rays))
    left = np.arange(len(rays))
    for _ in range(24):
        at = origins[left] + travelled[left, None] * rays[left]
        hit = scene.run(at.astype(np.float32), rays[left].astype(np.float32), query="INTERSECT", output=True)
        there = (hit["primID"] >= 0) & (travelled[left] + hit["tfar"] < reach)
        left, number = left[there], hit["primID"][there]
        distance = travelled[left] + hit["tfar"][there]
        # The twin's surfaces are seen from their front only.
        front = (normals[number] * rays[left]).sum(axis=1) < 0
        seen, seen_at = left[front], distance[front]
        room = count[seen] < found.shape[1]
        seen, seen_at = seen[room], seen_at[room]
        found[seen, count[seen]] = seen_at
        count[seen] += 1
        travelled[left] = distance + 1e-3
        left = left[~front | glass[number]]
        if len(left) == 0:
            break
    return found


def describe(stream):
    name, model = stream["name"], stream["model"]
    sigma, separation = stream["range_noise_m"], stream["separation_m"]
    parts = []
    config = vd.Config(model=vd.Model[model.upper()], min_range=0.1, max_range=250)
    for stamp, cloud in vd.read_pcap(os.path.join(folder, f"{name}.pcap"), config):
        # The sensor counts whole microseconds; a double of 1.8e9 s only nearly does.
        base = np.int64(round(stamp.device * 1e6)) * 1000
        time_ns = base + np.round(cloud[:, 4].astype(float) * 1e9).astype(np.int64)
        parts.append(np.column_stack([cloud.astype(float), (time_ns - pose_ns[0]).astype(float)]))
    cloud = np.concatenate(parts)
    xyz, ring, kind, time_ns = cloud[:, :3].copy(), cloud[:, 6].astype(int), cloud[:, 7].astype(int), cloud[:, 8]

    # Times, return by return: those of one ring in order of time, the farther of one shot first.
    truth = np.loadtxt(os.path.join(folder, f"{name}.txt"), dtype=str)
    true_ns = (truth[:, 0].astype(np.int64) - pose_ns[0]).astype(float)
    true_ring, true_range = truth[:, 1].astype(int), truth[:, 2].astype(float)
    elevation = np.radians(np.array(ELEVATIONS_DEG[model]))
    xyz[:, 2] -= OPTICAL_CENTRE_M[model] * np.tan(-elevation[ring])
    ranges = np.linalg.norm(xyz, axis=1)
    assert len(true_ns) == len(cloud), f"{name}: {len(true_ns)} returns sent, {len(cloud)} decoded"
    ours = np.lexsort([-true_range, np.round(true_ns, -3), true_ring])
    theirs = np.lexsort([-ranges, np.round(time_ns, -3), ring])
    late = time_ns[theirs] - true_ns[ours]
    far = np.abs(ranges[theirs] - true_range[ours])

    # Where each ray is in the world.
    span = pose_ns[-1] - pose_ns[0]
    inside = (time_ns > 0) & (time_ns < span)
    xyz, ranges, time_ns, kind = xyz[inside], ranges[inside], time_ns[inside], kind[inside]
    place = np.column_stack([np.interp(time_ns, pose_ns - pose_ns[0], path[:, i]) for i in range(3)])
    rotation = turn(time_ns)
    ray = xyz / ranges[:, None]
    right = np.column_stack([ray[:, 1], -ray[:, 0], np.zeros(len(ray))])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(right, ray)
    width, height = stream["divergence_rad"]
    met = []
    for across, above in [(0, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)]:
        beside = ray + 0.5 * (across * width * right + above * height * up)
        beside /= np.linalg.norm(beside, axis=1, keepdims=True)
        met.append(surfaces(place, rotation.apply(beside), 250.0))
    axis = met[0]
    # One surface: all five rays meet as many, at distances that a plane explains.
    same = np.ones(len(axis), bool)
    for other in met[1:]:
        same &= (np.isnan(other) == np.isnan(axis)).all(axis=1)
        same &= ~(np.abs(other - axis) > 0.02 + 0.02 * axis).any(axis=1)
    gaps = np.diff(axis, axis=1)
    clear = same & ~(gaps < separation).any(axis=1) & ~np.isnan(axis[:, 0])
    off = ranges[:, None] - axis
    nearest = np.nanargmin(np.where(np.isnan(off), 1e9, np.abs(off)), axis=1)
    residual = off[np.arange(len(off)), nearest][clear]
    everything = np.concatenate(met, axis=1)
    low, high = np.nanmin(everything, axis=1), np.nanmax(everything, axis=1)
    between = ((ranges > low - 5 * sigma) & (ranges < high + 5 * sigma))[~clear & ~np.isnan(low)]
    n = len(residual)
    core = residual[np.abs(residual) < 6 * sigma]
    print(
        f"| {name} | {len(cloud)} | {np.abs(late).max() / 1e3:.2f} µs | {1e3 * far.max():.1f} mm | {100 * clear.mean():.1f} % | "
        f"{1e3 * core.mean():+.2f} mm | {1e3 * core.std():.2f} mm | {100 * (np.abs(residual) > 1.96 * sigma).mean():.2f} % | "
        f"{100 * (np.abs(residual) > 3 * sigma).mean():.3f} % | {1e6 * (n - len(core)) / n:.0f} of 1e6 | "
        f"{kstest(core[:: max(1, n // 20000)] / sigma, 'norm').pvalue:.2f} | {100 * between.mean():.2f} % |"
    )
    if stream["dual"]:
        # BOTH is one return that is the strongest and the last.
        both = kind == int(vd.ReturnMode.BOTH)
        print(
            f"  {name}: {both.sum()} single returns, {(kind == int(vd.ReturnMode.LAST)).sum()} last and "
            f"{(kind == int(vd.ReturnMode.STRONGEST)).sum()} strongest of pairs"
        )


meta = json.load(open(os.path.join(folder, "packets.json")))
print("| packets | points | time off at most | range off at most | one surface | mean | deviation | beyond 1.96 σ | beyond 3 σ | beyond 6 σ | KS p | others between their surfaces |")
print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
for stream in meta["streams"]:
    describe(stream)
