"""LiDAR odometry in the twin's nine places, ours and PyPI kiss-icp on the same clouds; README.md says how it is run.

    python nine_places.py LSFB WORK --seeds 1 2 3 --seconds 60

Each place is simulated once and kept in WORK; what stands there is not made again. Truth is opened by `lsfb eval` alone.
"""

import argparse
import csv
import json
import subprocess
import tomllib
from pathlib import Path

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

PLACES = [
    "office-park", "house-park", "medium-office", "large-office", "exhibition-hall",
    "atrium", "wide-corridor", "narrow-corridor", "stairs",
]
# Cameras are there, as a rig has some, but cost nothing.
SETTINGS = """place = "{place}"
texel_m = 0.02
[scan]
duration_s = {seconds}
{walk}
[glasses]
duration_s = 1.0
[scan_cameras]
rate_hz = 1
width = 64
height = 40
[glasses_cameras]
rate_hz = 1
width = 64
height = 40
[lidar]
divergence_rad = [0.003, 0.0015]
[scan_imu]
gyro_bias_instability = 8.7e-5
accel_bias_instability = 1.5e-4
"""


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def simulate(lsfb, folder, place, seed, seconds, walk):
    if (folder / "done").exists():
        return
    settings = folder.with_suffix(".toml")
    settings.write_text(SETTINGS.format(place=place, seconds=seconds, walk=walk))
    code, _, problem = run(lsfb, "sim", "--config", settings, "--seed", seed, "--record", "--out", folder)
    if code != 0:
        raise SystemExit(f"{folder}: {problem}")
    (folder / "done").touch()


def clouds(scan):
    """Stamps, points in the LiDAR's frame and their times within the scan as shares of it."""
    with open(scan, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, cloud in reader.iter_decoded_messages(topics=["/lidar/points"]):
            kinds = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
            layout = np.dtype({
                "names": [f.name for f in cloud.fields],
                "formats": [kinds[f.datatype] for f in cloud.fields],
                "offsets": [f.offset for f in cloud.fields],
                "itemsize": cloud.point_step,
            })
            points = np.frombuffer(bytes(cloud.data), layout)
            places = np.stack([points[axis] for axis in "xyz"], 1).astype(float)
            field = next(name for name in layout.names if "time" in name or name == "t")
            times = points[field].astype(float) * (1.0 if layout[field].kind == "f" else 1e-9)
            real = np.isfinite(places).all(1)
            yield cloud.header.stamp.sec + cloud.header.stamp.nanosec * 1e-9, places[real], times[real]


def kiss(scan, out, outdoor):
    """KISS-ICP with deskewing, one thread, voxels of 0.25 m indoors and its own choice (1 m) outdoors, where that does better."""
    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = 100.0, 0.5, True
    config.mapping.voxel_size = 1.0 if outdoor else 0.25
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    with open(scan, "rb") as file:
        rig = next(a for a in make_reader(file).iter_attachments() if a.name == "rig.toml")
    lidar = tomllib.loads(rig.data.decode())["lidar"]
    pose = (lidar[0] if isinstance(lidar, list) else lidar)["rig_from_lidar"]
    rig_from_lidar = np.eye(4)
    rig_from_lidar[:3, :3] = Rotation.from_quat(pose["rotation_xyzw"]).as_matrix()
    rig_from_lidar[:3, 3] = pose["translation_m"]
    with open(out, "w") as lines:
        for stamp, places, times in clouds(scan):
            first, last = times.min(), times.max()
            odometry.register_frame(places, (times - first) / max(last - first, 1e-9))
            moved = rig_from_lidar @ odometry.last_pose @ np.linalg.inv(rig_from_lidar)
            # Its poses are those at the end of a scan.
            at = [stamp + last, *moved[:3, 3], *Rotation.from_matrix(moved[:3, :3]).as_quat()]
            lines.write(" ".join(f"{value:.9f}" for value in at) + "\n")


def judged(lsfb, estimate, truth, *more):
    code, text, problem = run(lsfb, "eval", estimate, "--truth", truth, "--json", *more)
    try:
        return code, json.loads(text)
    except json.JSONDecodeError:
        return code, {"problem": problem.strip()}


def main():
    asked = argparse.ArgumentParser()
    asked.add_argument("lsfb")
    asked.add_argument("work", type=Path)
    asked.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    asked.add_argument("--seconds", type=float, default=60.0)
    asked.add_argument("--places", nargs="+", default=PLACES)
    asked.add_argument("--walk", default="", help="more lines for [scan], for example 'turn_rate_rad_s = 2.0'")
    asked.add_argument("--peer-seeds", type=int, nargs="*", default=[1], help="seeds that the peer runs on: it takes minutes")
    args = asked.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    with open(args.work / "results.csv", "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["place", "seed", "exit", "path_m", "ate_rms_m", "within_95", "nees", "loops_exit", "loops", "rejected",
                       "loops_ate_rms_m", "loops_within_95", "kiss_ate_rms_m"])
        for place in args.places:
            for seed in args.seeds:
                folder = args.work / f"{place}-{seed}"
                simulate(args.lsfb, folder, place, seed, args.seconds, args.walk)
                rows.writerow([place, seed, *one(args, folder, place, seed in args.peer_seeds)])
                file.flush()


def one(args, folder, place, with_peer):
    scan, truth = folder / "scan.mcap", folder / "truth" / "truth_scan.tum"
    found = []
    for name, more in (("odometry", []), ("loops", ["--out-loops", folder / "loops.txt"])):
        out = folder / f"{name}.tum"
        code, text, _ = run(args.lsfb, "odometry", scan, "--out", out, "--force", "--json", *more)
        said = json.loads(text) if text.strip() else {}
        _, ate = judged(args.lsfb, out, truth)
        _, nees = judged(args.lsfb, folder / f"{name}_covariance.txt", truth, "--align", "origin")
        found.append((code, said, ate, nees))
    if with_peer:
        kiss(scan, folder / "kiss.tum", place.endswith("park"))
    _, peer = judged(args.lsfb, folder / "kiss.tum", truth) if with_peer else ({}, {})
    (plain_code, _, plain, plain_nees), (code, said, looped, looped_nees) = found
    rms = lambda figures: (figures.get("ate_translation_m") or {}).get("rmse")
    inside = lambda figures: (figures.get("consistency") or {}).get("within_95")
    return [plain_code, plain.get("truth_path_m"), rms(plain), inside(plain_nees), (plain_nees.get("consistency") or {}).get("nees_mean"),
            code, (said.get("loops") or {}).get("accepted"), (said.get("loops") or {}).get("rejected"), rms(looped), inside(looped_nees), rms(peer)]


main()
