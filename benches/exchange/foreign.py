"""Where foreign programs see points with the rig files in calib/tests/exchange: the expected values of
calib/tests/exchange.rs.

    python -m venv /tmp/exchange && /tmp/exchange/bin/pip install opencv-python-headless pycolmap pyyaml
    /tmp/exchange/bin/python benches/exchange/foreign.py calib/tests/exchange
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import yaml

POINTS = np.array([[0.3, -0.2, 1.5], [-0.4, 0.25, 1.2], [0.05, 0.4, 2.0]])


def show(name, pixels):
    for pixel in np.asarray(pixels).reshape(-1, 2):
        print(f"{name} {pixel[0]:.9f} {pixel[1]:.9f}")


def main(folder):
    for k in (0, 1):
        info = yaml.safe_load((folder / f"cam{k}.yaml").read_text())
        matrix = np.array(info["camera_matrix"]["data"]).reshape(3, 3)
        distortion = np.array(info["distortion_coefficients"]["data"])
        zero = np.zeros(3)
        points = POINTS.reshape(-1, 1, 3)
        if info["distortion_model"] == "equidistant":
            pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, matrix, distortion)
        else:
            pixels, _ = cv2.projectPoints(points, zero, zero, matrix, distortion)
        show(f"opencv cam{k}", pixels)
    cameras = {}
    for line in (folder / "cameras.txt").read_text().splitlines():
        if line.startswith("#"):
            continue
        words = line.split()
        cameras[int(words[0])] = pycolmap.Camera(
            model=words[1], width=int(words[2]), height=int(words[3]), params=[float(w) for w in words[4:]]
        )
    for number, camera in cameras.items():
        show(f"colmap cam{number - 1}", [camera.img_from_cam(p) for p in POINTS])
    config = pycolmap.read_rig_config(folder / "rig_config.json")[0]
    cam1_from_cam0 = config.cameras[1].cam_from_rig
    print("colmap cam1_from_cam0", *(cam1_from_cam0 * POINTS[0]))


main(Path(sys.argv[1]))
