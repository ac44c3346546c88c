"""The simulated LiDAR judged by others: packets decoded by PyPI velodyne-decoder, rays cast by Embree.

usage: lidar.py FOLDER          what `packets FOLDER` wrote

Every decoded point is put back on its ray, from the true pose at the point's own time; Embree says where that ray, and
27 more all over the beam, meet the surfaces. Points whose whole beam lies on one surface, and that met nothing else
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

folder = sys.argv[1]


def load(name, dtype, columns):
    values = np.fromfile(os.path.join(folder, name), dtype=dtype)
    return values.reshape(-1, columns) if columns > 1 else values


triangles = load("triangles.f32", "<f4", 9).reshape(-1, 3, 3)
normals = load("normals.f32", "<f4", 3)
glass = load("glass.u8", "u1", 1) > 0
# Leaves and the like are two surfaces back to back: moved apart by less than matters, the one in front is met first.
triangles = triangles + 5e-5 * normals[:, None, :]
scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, np.ascontiguousarray(triangles, dtype=np.float32))
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
    """Distances at which each ray meets surfaces, up to and with the first that is no glass, and which; NaN beyond."""
    found = np.full((len(rays), 8), np.nan)
    which = np.zeros(found.shape, int)
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
        seen = front & (count[left] < found.shape[1])
        place = (left[seen], count[left[seen]])
        found[place], which[place] = distance[seen], number[seen]
        count[left[seen]] += 1
        travelled[left] = distance + 1e-3
        left = left[~front | glass[number]]
        if len(left) == 0:
            break
    return found, which


def packets(path):
    """Arrival and UDP payload of every packet."""
    data = open(path, "rb").read()
    at = 24
    while at < len(data):
        secs, nanos, length = (int.from_bytes(data[at + i : at + i + 4], "little") for i in (0, 4, 8))
        yield secs, nanos, data[at + 16 + 42 : at + 16 + length]
        at += 16 + length


def decode(path, model):
    """Points (x, y, z, intensity, time, column, ring, return type) and their times, nanoseconds since 1970."""
    decoder = vd.StreamDecoder(vd.Config(model=vd.Model[model.upper()], min_range=0.1, max_range=250))
    clouds, times, day = [], [], None
    # On the first day of all, where double precision is finer than the sensor's microseconds.
    stream = [*packets(path), None]
    for packet in stream:
        if packet is None:
            scan = decoder.finish(False)
        else:
            secs, nanos, payload = packet
            day = day or secs // 86400 * 86400
            scan = decoder.decode(secs - day + nanos * 1e-9, payload, False)
        if scan is not None:
            stamp, cloud = scan
            clouds.append(cloud.astype(float))
            times.append(day * 10**9 + np.round((stamp.device + clouds[-1][:, 4]) * 1e9).astype(np.int64))
    return np.concatenate(clouds), np.concatenate(times)


def describe(stream):
    name, model = stream["name"], stream["model"]
    sigma, separation = stream["range_noise_m"], stream["separation_m"]
    cloud, time_ns = decode(os.path.join(folder, f"{name}.pcap"), model)
    time_ns = (time_ns - pose_ns[0]).astype(float)
    xyz, ring, kind = cloud[:, :3].copy(), cloud[:, 6].astype(int), cloud[:, 7].astype(int)

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
    steps = [-1, -2 / 3, -1 / 3, 0, 1 / 3, 2 / 3, 1]
    pattern = [(0, 0)] + [(x, y) for x in steps for y in steps[::2] if (x, y) != (0, 0)]
    beams = [ray + 0.5 * (across * width * right + above * height * up) for across, above in pattern]
    beams = [rotation.apply(beam / np.linalg.norm(beam, axis=1, keepdims=True)) for beam in beams]
    met = [surfaces(place, beam, 250.0) for beam in beams]
    axis, facing = met[0][0], normals[met[0][1]]
    # One surface: every ray meets as many as the axis does, and where the axis's planes are.
    same = ~np.isnan(axis[:, 0])
    for (other, _), beam in zip(met[1:], beams[1:]):
        towards = [np.einsum("nki,ni->nk", facing, b) for b in (beams[0], beam)]
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = axis * towards[0] / towards[1]
        same &= (np.isnan(other) == np.isnan(axis)).all(axis=1)
        same &= ~(np.abs(other - expected) > 0.01).any(axis=1)
    gaps = np.diff(axis, axis=1)
    clear = same & ~(gaps < separation).any(axis=1)
    off = ranges[:, None] - axis
    nearest = np.nanargmin(np.where(np.isnan(off), 1e9, np.abs(off)), axis=1)
    residual = off[np.arange(len(off)), nearest][clear]
    everything = np.concatenate([found for found, _ in met], axis=1)
    low, high = np.nanmin(everything, axis=1), np.nanmax(everything, axis=1)
    between = ((ranges > low - 5 * sigma) & (ranges < high + 5 * sigma))[~clear & ~np.isnan(low)]
    n = len(residual)
    core = residual[np.abs(residual) < 6 * sigma]
    print(
        f"| {name} | {len(cloud)} | {np.abs(late).max() / 1e3:.2f} µs | {1e3 * far.max():.1f} mm | {100 * clear.mean():.1f} % | "
        f"{1e3 * core.mean():+.2f} mm | {1e3 * core.std():.2f} mm | {100 * (np.abs(residual) > 1.96 * sigma).mean():.2f} % | "
        f"{100 * (np.abs(residual) > 3 * sigma).mean():.3f} % | {1e6 * (n - len(core)) / n:.0f} of 1e6 | "
        f"{100 * between.mean():.2f} % |"
    )
    if stream["dual"]:
        # BOTH is one return that is the strongest and the last.
        both = kind == vd.ReturnMode.BOTH.value
        print(
            f"  {name}: {both.sum()} single returns, {(kind == vd.ReturnMode.LAST.value).sum()} last and "
            f"{(kind == vd.ReturnMode.STRONGEST.value).sum()} strongest of pairs"
        )


meta = json.load(open(os.path.join(folder, "packets.json")))
print("| packets | points | time off at most | range off at most | one surface | mean | deviation | beyond 1.96 σ | beyond 3 σ | beyond 6 σ | others between their surfaces |")
print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
for stream in meta["streams"]:
    describe(stream)
