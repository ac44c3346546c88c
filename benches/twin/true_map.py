"""A simulated map with what the scan knows of itself replaced by the truth: what the map costs a walk in it.

usage: true_map.py MAP TRUTH OUT     (a folder of `lsfb map`, the folder `truth` of the same simulation, and the map to write)

Keyframes get the scanner's true poses. Each point is laid where the rays of its observations, from the true poses through the
pixels, meet the true surfaces: the median of these places. Descriptors, index and observations stay. Points whose rays nowhere
meet a surface stay where their keyframe's true pose puts them. The result is for benches alone.
"""

import hashlib
import os
import re
import shutil
import sys
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.ipc as ipc
import trimesh
from scipy.spatial.transform import Rotation, Slerp

source, truth, out = sys.argv[1:4]
# Standard deviations that a map of true places has left: of points, metres, and of keyframes, radians and metres.
POINT_SIGMA_M, KEYFRAME_SIGMA = 5e-4, 1e-5
# A ray that passes an edge by a hair meets what is far behind it.
FAR_FROM_MEDIAN_M = 0.03


def table(name):
    with ipc.open_file(f"{source}/{name}") as file:
        return file.read_all()


def write(name, original, columns):
    changed = original
    for column, values in columns.items():
        at = changed.schema.get_field_index(column)
        field = changed.schema.field(at)
        changed = changed.set_column(at, field, pa.chunked_array([pa.array(values, field.type)]))
    with ipc.new_file(f"{out}/{name}", changed.schema) as file:
        for batch in changed.combine_chunks().to_batches():
            file.write_batch(batch)


def rays_in_camera(camera, pixels):
    lens = camera["lens"]
    assert lens["model"] == "kannala-brandt", lens["model"]
    d = (pixels - lens["principal_px"]) / lens["focal_px"]
    bent = np.linalg.norm(d, axis=1)
    k = lens["distortion"]
    angle = bent.copy()
    for _ in range(30):
        a2 = angle**2
        value = angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))) - bent
        slope = 1 + a2 * (3 * k[0] + a2 * (5 * k[1] + a2 * (7 * k[2] + a2 * 9 * k[3])))
        angle -= value / slope
    across = d / np.maximum(bent, 1e-12)[:, None]
    return np.column_stack([across * np.sin(angle)[:, None], np.cos(angle)])


points, keyframes, observations = table("points.arrow"), table("keyframes.arrow"), table("observations.arrow")
rig = tomllib.load(open(f"{source}/rig.toml", "rb"))
names = sorted(rig["cameras"])
path = np.loadtxt(f"{truth}/truth_scan.tum")
# Times of day in nanoseconds: doubles have no digits for those since 1970.
begin = path[0, 0]
when = keyframes["time_ns"].to_numpy() * 1e-9 - begin
at = path[:, 0] - begin
world_from_rig = Slerp(at, Rotation.from_quat(path[:, 4:8]))(when)
position = np.column_stack([np.interp(when, at, path[:, i]) for i in range(1, 4)])

of_keyframe = observations["keyframe"].to_numpy()
of_point = observations["point"].to_numpy()
of_camera = observations["camera"].to_numpy()
pixels = np.column_stack([observations["u_px"].to_numpy(), observations["v_px"].to_numpy()]).astype(float)
origins, directions = np.zeros((len(pixels), 3)), np.zeros((len(pixels), 3))
for number, name in enumerate(names):
    seen = of_camera == number
    camera = rig["cameras"][name]
    in_rig = Rotation.from_quat(camera["rig_from_camera"]["rotation_xyzw"]).apply(rays_in_camera(camera["camera"], pixels[seen]))
    turns = world_from_rig[of_keyframe[seen]]
    directions[seen] = turns.apply(in_rig)
    origins[seen] = turns.apply(camera["rig_from_camera"]["translation_m"]) + position[of_keyframe[seen]]

surfaces = trimesh.load(f"{truth}/world.ply", process=False)
from trimesh.ray.ray_pyembree import RayMeshIntersector

places, hit, _ = RayMeshIntersector(surfaces).intersects_location(origins, directions, multiple_hits=False)
met = np.full((len(pixels), 3), np.nan)
met[hit] = places

# Where the map had it, moved with the first keyframe that saw it.
old_turn = Rotation.from_quat(np.column_stack([keyframes[c].to_numpy() for c in ("qx", "qy", "qz", "qw")]))
old_position = np.column_stack([keyframes[c].to_numpy() for c in ("tx_m", "ty_m", "tz_m")])
old = np.column_stack([points[c].to_numpy() for c in ("x_m", "y_m", "z_m")])
first = of_keyframe[points["first_observation"].to_numpy()]
new = world_from_rig[first].apply(old_turn[first].inv().apply(old - old_position[first])) + position[first]
order = np.argsort(of_point, kind="stable")
spreads, laid = [], 0
for group in np.split(order, np.flatnonzero(np.diff(of_point[order])) + 1):
    own = met[group]
    own = own[~np.isnan(own[:, 0])]
    if len(own) == 0:
        continue
    middle = np.median(own, axis=0)
    near = own[np.linalg.norm(own - middle, axis=1) < FAR_FROM_MEDIAN_M]
    if len(near) == 0:
        continue
    spreads.append(np.sqrt(((near - near.mean(0)) ** 2).sum(1).mean()))
    new[of_point[group[0]]] = near.mean(0)
    laid += 1
moved = np.linalg.norm(new - (world_from_rig[first].apply(old_turn[first].inv().apply(old - old_position[first])) + position[first]), axis=1)
print(f"{laid} of {len(new)} points laid on surfaces, moved by {1e3 * np.median(moved):.1f} mm in the median; "
      f"their rays meet within {1e3 * np.median(spreads):.1f} mm rms in the median")

os.makedirs(out, exist_ok=True)
for name in os.listdir(source):
    shutil.copy(f"{source}/{name}", f"{out}/{name}")
n = len(new)
columns = {"x_m": new[:, 0], "y_m": new[:, 1], "z_m": new[:, 2]}
for name in ("xx", "xy", "xz", "yy", "yz", "zz"):
    on_diagonal = name[0] == name[1]
    columns[f"cov_{name}_m2"] = np.full(n, POINT_SIGMA_M**2 if on_diagonal else 0.0, np.float32)
write("points.arrow", points, columns)
turn = world_from_rig.as_quat()
columns = {c: turn[:, i] for i, c in enumerate(("qx", "qy", "qz", "qw"))}
columns |= {c: position[:, i] for i, c in enumerate(("tx_m", "ty_m", "tz_m"))}
for name in keyframes.schema.names:
    if parts := re.fullmatch(r"cov_(\w\w)_(\w\w)_.*", name):
        same = parts[1] == parts[2]
        # The first keyframe is exact, and zero.
        values = np.full(len(when), KEYFRAME_SIGMA**2 if same else 0.0)
        values[0] = 0.0
        columns[name] = values
write("keyframes.arrow", keyframes, columns)
header = open(f"{source}/map.toml").read()
for name in ("points.arrow", "keyframes.arrow"):
    data = open(f"{out}/{name}", "rb").read()
    # Without a checksum of its own a file is held against its hash.
    header = re.sub(
        rf'(name = "{name}"\nbytes = )\d+(\nsha256 = ")[0-9a-f]+("\n)crc32c = "[0-9a-f]+"\n',
        lambda m: f"{m[1]}{len(data)}{m[2]}{hashlib.sha256(data).hexdigest()}{m[3]}",
        header,
    )
open(f"{out}/map.toml", "w").write(header)
