"""Odometry of small_gicp (PyPI) on a KITTI folder of scans, for `lsfb bench slam`: python small_gicp_kitti.py INPUT OUT.tum"""
import pathlib, sys
import numpy as np, small_gicp
source, out = pathlib.Path(sys.argv[1]), sys.argv[2]
stamps = (source / "velodyne_stamps.txt").read_text().split()
world = small_gicp.GaussianVoxelMap(0.5)
pose = before = np.eye(4)
rows = []
for stamp, path in zip(stamps, sorted((source / "velodyne").glob("*.bin"))):
    points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    points = points[np.linalg.norm(points, axis=1) > 0.5]
    cloud, tree = small_gicp.preprocess_points(points, 0.1, num_threads=1)
    if rows:
        guess = pose @ np.linalg.inv(before) @ pose
        found = small_gicp.align(world, cloud, guess, max_correspondence_distance=1.0, num_threads=1)
        before, pose = pose, found.T_target_source
    world.insert(cloud, pose)
    w = np.sqrt(max(0.0, 1 + np.trace(pose[:3, :3]))) / 2
    r = pose[:3, :3]
    q = [(r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w), w]
    rows.append(" ".join([stamp, *map(repr, map(float, [*pose[:3, 3], *q]))]))
open(out, "w").write("\n".join(rows) + "\n")
