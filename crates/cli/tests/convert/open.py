"""Opens one trajectory in the files of six programs with readers of others, and prints what each of them finds, a line each:
its name, how many poses, and of the last one stamp, position and quaternion (x, y, z, w; w positive).

Usage: open.py FOLDER, with walk.tum, walk_euroc.csv, walk_kitti.txt, walk_kitti_times.txt, walk.csv, walk_kapture and walk.mcap in it.
Of PyPI: evo, kapture, pandas and mcap-ros2-support, where this Python has them.
"""

import importlib.util
import pathlib
import sys

root = pathlib.Path(sys.argv[1])


def has(name):
    return importlib.util.find_spec(name) is not None


def say(name, count, stamp, position, x, y, z, w):
    sign = -1.0 if w < 0 else 1.0
    numbers = [stamp, *position, sign * x, sign * y, sign * z, sign * w]
    print(name, count, *(f"{float(v):.9f}" for v in numbers))


if has("evo"):
    import numpy
    from evo.core import transformations
    from evo.tools import file_interface

    for name, found in [
        ("evo-tum", file_interface.read_tum_trajectory_file(str(root / "walk.tum"))),
        ("evo-euroc", file_interface.read_euroc_csv_trajectory(str(root / "walk_euroc.csv"))),
    ]:
        w, x, y, z = found.orientations_quat_wxyz[-1]
        say(name, found.num_poses, found.timestamps[-1], found.positions_xyz[-1], x, y, z, w)
    found = file_interface.read_kitti_poses_file(str(root / "walk_kitti.txt"))
    times = numpy.loadtxt(root / "walk_kitti_times.txt")
    w, x, y, z = transformations.quaternion_from_matrix(found.poses_se3[-1])
    say("evo-kitti", min(found.num_poses, len(times)), times[-1], found.positions_xyz[-1], x, y, z, w)
if has("kapture"):
    from kapture.io.csv import kapture_from_dir

    poses = kapture_from_dir(str(root / "walk_kapture")).trajectories
    stamp = max(poses)
    world = poses[stamp]["rig"].inverse()
    say("kapture", len(poses), stamp * 1e-9, world.t.ravel(), world.r.x, world.r.y, world.r.z, world.r.w)
if has("pandas"):
    import pandas

    table = pandas.read_csv(root / "walk.csv")
    last = table.iloc[-1]
    position = [last.x_m, last.y_m, last.z_m]
    say("pandas", len(table), last.timestamp_s, position, last.qx, last.qy, last.qz, last.qw)
if has("mcap_ros2"):
    from mcap_ros2.reader import read_ros2_messages

    messages = list(read_ros2_messages(str(root / "walk.mcap"), topics=["/pose"]))
    last = messages[-1].ros_msg
    p, q, stamp = last.pose.position, last.pose.orientation, last.header.stamp
    say("mcap-ros2", len(messages), stamp.sec + 1e-9 * stamp.nanosec, [p.x, p.y, p.z], q.x, q.y, q.z, q.w)
