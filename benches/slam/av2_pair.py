"""The pair of sweeps in DATA/lidar/av2_sensor for `lsfb odometry`, and its result against the ego poses beside it.

python av2_pair.py DATA/lidar/av2_sensor OUT          writes OUT/*.bin (coordinates are half floats in the original)
lsfb odometry OUT --outdoor --out OUT.tum
python av2_pair.py DATA/lidar/av2_sensor OUT OUT.tum  prints how far it is off

Needs numpy, scipy and pyarrow.
"""

import sys
from pathlib import Path

import numpy as np
import pyarrow.feather as feather
from scipy.spatial.transform import Rotation


def matrix(translation, quaternion_xyzw):
    pose = np.eye(4)
    pose[:3, 3] = translation
    pose[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    return pose


def main():
    log = next(p for p in Path(sys.argv[1]).iterdir() if p.is_dir())
    out = Path(sys.argv[2])
    sweeps = sorted((log / "sensors" / "lidar").glob("*.feather"))
    if len(sys.argv) == 3:
        out.mkdir(parents=True, exist_ok=True)
        for sweep in sweeps:
            table = feather.read_table(sweep)
            points = [table[k].to_numpy().astype("<f4") for k in ("x", "y", "z", "intensity")]
            np.stack(points, 1).tofile(out / f"{sweep.stem}.bin")
        return
    ego = feather.read_table(log / "city_SE3_egovehicle.feather").to_pydict()
    given = []
    for sweep in sweeps:
        i = ego["timestamp_ns"].index(int(sweep.stem))
        given.append(matrix([ego[k][i] for k in ("tx_m", "ty_m", "tz_m")], [ego[k][i] for k in ("qx", "qy", "qz", "qw")]))
    rows = [[float(w) for w in line.split()] for line in open(sys.argv[3]) if not line.startswith("#")]
    found = [matrix(row[1:4], row[4:8]) for row in (rows[0], rows[-1])]
    off = np.linalg.inv(np.linalg.inv(given[0]) @ given[1]) @ np.linalg.inv(found[0]) @ found[1]
    turn = Rotation.from_matrix(off[:3, :3]).magnitude()
    print(f"off by {100 * np.linalg.norm(off[:3, 3]):.2f} cm, {np.degrees(turn):.3f}°")


main()
