#!/usr/bin/env bash
# What limits glasses in the demo's room: each part of what a walk rests on is switched to the truth by itself, then all together.
# usage: moonshot.sh LSFB PYTHON SEED OUT      (a built lsfb; Python with numpy, scipy, pyarrow, trimesh, embreex; a folder)
#
# Truth stands in recordings and maps that are made here alone. The map: `true_map.py`. The IMU: a hundredth of its noise, no biases.
# Images: without noise, twice the pixels (of which so many of the map's points are not found that the place is taken for another: that limit is
# raised). Calibration: rigs are exact anyway; here it is also told that they are.
set -e
lsfb=$1 python=$2 seed=$3 out=$4
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$out"
cd "$out"

imu='[glasses_imu]
gyro_noise_density = 1.56e-5
accel_noise_density = 1.77e-5
gyro_bias_walk = 6e-7
accel_bias_walk = 6e-6
gyro_bias = 0.0
accel_bias = 0.0'
images='[glasses_cameras]
width = 1280
height = 800
focal_per_width = 0.4547
read_noise = 0.0
shot_noise = 0.0'
printf 'seed = %s\n' "$seed" > as-is.toml
printf 'seed = %s\n%s\n' "$seed" "$imu" > imu.toml
printf 'seed = %s\n%s\n' "$seed" "$images" > images.toml
printf 'seed = %s\n%s\n%s\n' "$seed" "$imu" "$images" > both.toml
cat > exact-rig.toml <<'SETTINGS'
extrinsics_sigma_rad = 1e-7
extrinsics_sigma_m = 1e-7
focal_sigma = 1e-7
camera_clock_sigma_s = 1e-7
readout_sigma_s = 1e-7
SETTINGS
echo 'max_absent_share = 1.0' > any-place.toml
cat exact-rig.toml any-place.toml > all.toml
for walk in as-is imu images both; do
  [ -e "$walk/walk.mcap" ] || "$lsfb" sim --config "$walk.toml" --record --force --quiet --out "$walk"
done
"$lsfb" map as-is/scan.mcap --out map --out-trajectory scan.tum --quiet
[ -e true-map/map.toml ] || "$python" "$here/true_map.py" map as-is/truth true-map

run() {
  name=$1 walk=$2 map=$3
  shift 3
  "$lsfb" groundtruth "$walk/walk.mcap" --map "$map" --out "$name.tum" --quiet "$@" > "$name.txt" || true
  "$python" - "$name" "$walk" <<'PYTHON'
import sys

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

name, walk = sys.argv[1:3]
try:
    found = np.loadtxt(f"{name}.tum")
except OSError:
    print(f"{name:12} refused")
    sys.exit()
truth = np.loadtxt(f"{walk}/truth/truth_walk.tum")
begin = truth[0, 0]
at, when = truth[:, 0] - begin, found[:, 0] - begin
inside = (when >= at[0]) & (when <= at[-1])
found, when = found[inside], when[inside]
there = np.column_stack([np.interp(when, at, truth[:, i]) for i in (1, 2, 3)])
turned = Slerp(at, Rotation.from_quat(truth[:, 4:8]))(when)
own, own_turned = found[:, 1:4], Rotation.from_quat(found[:, 4:8])
a, b = own - own.mean(0), there - there.mean(0)
u, _, v = np.linalg.svd(b.T @ a)
laid = Rotation.from_matrix(u @ np.diag((1, 1, np.sign(np.linalg.det(u @ v)))) @ v)
off_m = np.linalg.norm(laid.apply(a) - b, axis=1)
off_deg = np.degrees((turned.inv() * laid * own_turned).magnitude())


def between(turn, place):
    return turn[:-1].inv() * turn[1:], turn[:-1].inv().apply(place[1:] - place[:-1])


(turn, way), (true_turn, true_way) = between(own_turned, own), between(turned, there)
next_m, next_deg = np.linalg.norm(way - true_way, axis=1), np.degrees((true_turn.inv() * turn).magnitude())
rms = lambda x: np.sqrt((x**2).mean())
print(
    f"{name:12} {len(own)} poses: absolute {1e3 * rms(off_m):.2f} mm, {rms(off_deg):.3f} degrees; "
    f"between neighbours {1e3 * rms(next_m):.3f} mm, {rms(next_deg):.4f} degrees rms"
)
PYTHON
}
run as-is as-is map
run true-map as-is true-map
run exact-rig as-is map --config exact-rig.toml
run imu imu map
run images images map --config any-place.toml
run all both true-map --config all.toml
