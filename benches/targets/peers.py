"""Boards found by OpenCV and by aprilgrid: images, corners, CPU time per image, and how well the corners fit a camera.

Recipe: python3 -m venv v && v/bin/pip install numpy opencv-contrib-python-headless aprilgrid
        cargo build --release -p lsfb-calib --example detect_folder
        v/bin/python peers.py DATA target/release/examples/detect_folder
DATA is the folder of recordings made by others. The fit is of the same kind for all three: checkerboards by OpenCV's own
calibration of the corners, the AprilGrid by one pose per image with the official lens.
"""
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from aprilgrid import Detector

data, ours = Path(sys.argv[1]), sys.argv[2]
cv2.setNumThreads(1)


def checker_points(n, columns=9, rows=6):
    return np.array([[i % columns, i // columns, 0] for i in range(n)], np.float32)


def opencv(image):
    found, corners = cv2.findChessboardCorners(image, (9, 6))
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    return cv2.cornerSubPix(image, corners, (11, 11), (-1, -1), criteria)


def opencv_sb(image):
    found, corners = cv2.findChessboardCornersSB(image, (9, 6))
    return corners if found else None


def tag_point(index, pitch=0.088 * 1.3):
    tag, corner = divmod(index, 4)
    return [tag % 6 * pitch + 0.088 * (corner in (1, 2)), tag // 6 * pitch + 0.088 * (corner in (2, 3)), 0]


def report(name, views, images, seconds, rms):
    count = sum(len(v) for v in views)
    print(f"  {name:24} {len(views)} of {images} images, {count} corners, {seconds * 1e3 / images:.1f} ms per image, fit {rms:.3f} px rms")


def run_ours(folder, *target):
    before = time.perf_counter()
    text = subprocess.run([ours, str(folder), *target, "--corners"], capture_output=True, text=True, check=True).stdout
    views = {}
    for line in text.splitlines()[:-1]:
        name, index, x, y = line.split()
        views.setdefault(name, []).append((int(index), float(x), float(y)))
    milliseconds = float(text.splitlines()[-1].split("corners, ")[1].split(" ms")[0])
    return views, milliseconds * 1e-3


for folder, prefix in [("calib_opencv_stereo", "left"), ("calib_opencv_stereo", "right")]:
    path = data / "vision" / folder
    files = sorted(path.glob(prefix + "*.jpg"))
    images = [cv2.imread(str(f), cv2.IMREAD_GRAYSCALE) for f in files]
    size = images[0].shape[::-1]
    print(folder, prefix)

    def fit(views):
        return cv2.calibrateCamera([checker_points(54)] * len(views), [np.float32(v).reshape(-1, 1, 2) for v in views], size, None, None)[0]

    for name, find in (("OpenCV, subpixel 11", opencv), ("OpenCV SB", opencv_sb)):
        start = time.process_time()
        views = [v for v in (find(i) for i in images) if v is not None]
        report(name, views, len(images), time.process_time() - start, fit(views))
    found, seconds = run_ours(path, "checkerboard", "9", "6", "1")
    views = [np.array([c[1:] for c in v]) for n, v in sorted(found.items()) if n.startswith(prefix)]
    report("lsfb", views, len(images), seconds * len(images), fit(views))

print("tumvi_calib_imu1 cam0, every tenth image")
tum = data / "vision/tumvi_calib_imu1"
lens = json.loads((tum / "reference_calibration.json").read_text())["cam0"]
fx, fy, cx, cy = lens["intrinsics"]
K, k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(lens["k"])


def fit_grid(views):
    squares, count = 0.0, 0
    for view in views:
        points = np.array([tag_point(c[0]) for c in view])
        pixels = np.array([c[1:] for c in view])
        flat = cv2.fisheye.undistortPoints(pixels.reshape(-1, 1, 2), K, k)
        _, r, t = cv2.solvePnP(points, flat, np.eye(3), None)
        seen = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), r, t, K, k)[0].reshape(-1, 2)
        squares += ((seen - pixels) ** 2).sum()
        count += len(view)
    return np.sqrt(squares / count)


files = sorted((tum / "mav0/cam0/data").glob("*.jpg"))[::10]
images = [cv2.imread(str(f), cv2.IMREAD_GRAYSCALE) for f in files]
detector = Detector("t36h11")
start = time.process_time()
views = []
for image in images:
    tags = [t for t in detector.detect(image) if t.tag_id < 36]
    # aprilgrid's corners start elsewhere on the tag: the turn that fits is taken below
    views.append([(4 * int(t.tag_id) + c, *np.ravel(t.corners[c])) for t in tags for c in range(4)])
seconds = time.process_time() - start
views = [v for v in views if len(v) >= 8]
orders = [[(4 * (i // 4) + order[i % 4], x, y) for i, x, y in v] for order in ([0, 1, 2, 3], [1, 2, 3, 0], [2, 3, 0, 1], [3, 0, 1, 2], [3, 2, 1, 0], [2, 1, 0, 3], [1, 0, 3, 2], [0, 3, 2, 1]) for v in views]
n = len(views)
report("aprilgrid", views, len(images), seconds, min(fit_grid(orders[j * n:(j + 1) * n]) for j in range(8)))
found, seconds = run_ours(tum / "mav0/cam0/data", "aprilgrid", "6", "6", "0.088", "0.3")
names = {f.name for f in files}
report("lsfb", [v for n, v in found.items() if n in names], len(images), seconds * len(images), fit_grid([v for n, v in found.items() if n in names]))

# Speed at 1280 x 800, CPU time of one thread: the AprilGrid images enlarged, the checkerboard's cropped.
def cpu_of(run):
    start = resource.getrusage(resource.RUSAGE_CHILDREN), time.process_time()
    run()
    end = resource.getrusage(resource.RUSAGE_CHILDREN), time.process_time()
    children = end[0].ru_utime + end[0].ru_stime - start[0].ru_utime - start[0].ru_stime
    return children + end[1] - start[1]


def ours_cpu(folder, *target):
    run = lambda n: cpu_of(lambda: subprocess.run([ours, str(folder), *target, "--repeat", str(n)], capture_output=True, check=True, env={**os.environ, "RAYON_NUM_THREADS": "1"}))
    return (run(21) - run(1)) / 20


print("1280 x 800, CPU time of one thread")
with tempfile.TemporaryDirectory() as scratch:
    grids = [cv2.resize(cv2.imread(str(f), cv2.IMREAD_GRAYSCALE)[96:416], (1280, 800), interpolation=cv2.INTER_CUBIC) for f in sorted((tum / "mav0/cam0/data").glob("*.jpg"))[::20]]
    boards = [cv2.imread(str(f), cv2.IMREAD_GRAYSCALE)[80:880] for f in sorted((data / "vision/calib_camodocal_fisheye").glob("*.jpg"))]
    for name, images in (("grids", grids), ("boards", boards)):
        (Path(scratch) / name).mkdir()
        for k, image in enumerate(images):
            cv2.imwrite(f"{scratch}/{name}/{k:03}.png", image)
    aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    rate = lambda name, images, seconds: print(f"  {name:32} {len(images) / seconds:.0f} images/s")
    rate("lsfb, AprilGrid", grids, ours_cpu(f"{scratch}/grids", "aprilgrid", "6", "6", "0.088", "0.3"))
    rate("aprilgrid", grids, cpu_of(lambda: [detector.detect(i) for i in grids]))
    rate("OpenCV aruco", grids, cpu_of(lambda: [aruco.detectMarkers(i) for i in grids]))
    rate("lsfb, checkerboard", boards, ours_cpu(f"{scratch}/boards", "checkerboard", "9", "6", "0.1"))
    rate("OpenCV, subpixel 11", boards, cpu_of(lambda: [opencv(i) for i in boards]))
    rate("OpenCV SB", boards, cpu_of(lambda: [opencv_sb(i) for i in boards]))
