"""How far the car of `udacity_kitti_raw/data_1` came: KISS-ICP forwards, backwards and begun later, and direct registrations by small_gicp.

    python kitti_ends.py DATA/lidar/udacity_kitti_raw

Needs PyPI kiss-icp and small_gicp. KISS-ICP's poses beside the recording are its forward run.
"""

import sys
from pathlib import Path

import numpy as np
import small_gicp
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP


def read(path):
    bytes_of = path.read_bytes()
    begin = bytes_of.index(b"DATA binary\n") + len(b"DATA binary\n")
    numbers = (len(bytes_of) - begin) // 16 * 16
    return np.frombuffer(bytes_of[begin : begin + numbers], "<f4").reshape(-1, 4)[:, :3].astype(float)


def kiss_steps(clouds):
    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = 100.0, 5.0, False
    config.mapping.voxel_size = 1.0
    config.registration.max_num_threads = 1
    odometry, places = KissICP(config), []
    for cloud in clouds:
        odometry.register_frame(cloud, np.zeros(len(cloud)))
        places.append(odometry.last_pose[:3, 3].copy())
    return np.linalg.norm(np.diff(places, axis=0), axis=1), np.linalg.norm(places[-1])


def direct(target, source, guess_m, kind):
    guess = np.eye(4)
    guess[0, 3] = guess_m
    sides = [small_gicp.preprocess_points(c, downsampling_resolution=0.25, num_neighbors=20) for c in (target, source)]
    (fixed, tree), (moving, _) = sides
    found = small_gicp.align(fixed, moving, tree, init_T_target_source=guess, registration_type=kind,
                             max_correspondence_distance=1.0, max_iterations=50)
    return np.linalg.norm(found.T_target_source[:3, 3])


def main():
    clouds = [read(path) for path in sorted((Path(sys.argv[1]) / "data_1").glob("*.pcd"))]
    forwards, end = kiss_steps(clouds)
    backwards, end_back = kiss_steps(clouds[::-1])
    print("KISS-ICP forwards: first steps", forwards[:3].round(3), "end", round(end, 3))
    print("KISS-ICP backwards: the same steps", backwards[::-1][:3].round(3), "end", round(end_back, 3))
    for first in range(1, 7):
        print(f"KISS-ICP begun at scan {first}: its first step {kiss_steps(clouds[first : first + 3])[0][0]:.3f},",
              f"backwards {backwards[::-1][first]:.3f}")
    for kind in ("GICP", "PLANE_ICP"):
        steps = [direct(clouds[k], clouds[k + 1], 0.8, kind) for k in range(3)]
        ends = [direct(clouds[0], clouds[-1], guess_m, kind) for guess_m in (16.73, 16.90)]
        print(kind, "first steps", np.round(steps, 3), "last scan on the first", np.round(ends, 3))


main()
