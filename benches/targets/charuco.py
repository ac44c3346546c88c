"""ChArUco boards drawn by OpenCV, seen by a tilted camera with blur and noise: corners found by OpenCV's CharucoDetector and
by lsfb, against the truth; CPU time of one thread per image.

Recipe: python3 -m venv v && v/bin/pip install numpy opencv-contrib-python-headless
        cargo build --release -p lsfb-calib --example detect_folder
        v/bin/python charuco.py target/release/examples/detect_folder
"""
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

IMAGES, SIZE = 60, (1280, 800)
SQUARES, SQUARE_M, MARKER_M = (11, 8), 0.03, 0.022
PIXELS_PER_SQUARE = 200
ours = sys.argv[1]
cv2.setNumThreads(1)
random = np.random.default_rng(7)


def pose():
    """Homography from the drawing to an image: any turn about the axis, tilted up to 45°, at many distances."""
    turn, tilt, about = random.uniform(0, 360), random.uniform(0, 45), random.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0]) * np.deg2rad(tilt)
    rotation = cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(np.array([0, 0, np.deg2rad(turn)]))[0]
    camera = np.array([[900, 0, 639.5], [0, 900, 399.5], [0, 0, 1.0]])
    place = np.array([random.uniform(-0.06, 0.06), random.uniform(-0.04, 0.04), random.uniform(0.35, 0.9)])
    middle = np.array(SQUARES) * SQUARE_M / 2
    metres = np.array([[SQUARE_M / PIXELS_PER_SQUARE, 0, -middle[0]], [0, SQUARE_M / PIXELS_PER_SQUARE, -middle[1]], [0, 0, 1]])
    # Pixel (0, 0) of the drawing has its centre half a pixel inside.
    metres = metres @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return camera @ np.column_stack([rotation[:, 0], rotation[:, 1], place]) @ metres


def render(drawing, homography):
    """Three times as large, blurred and made small: aliasing would be nobody's fault."""
    fine = 3
    larger = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
    size = (SIZE[0] * fine, SIZE[1] * fine)
    image = cv2.warpPerspective(drawing, larger @ homography, size, flags=cv2.INTER_AREA, borderValue=230)
    image = cv2.GaussianBlur(image, (0, 0), 0.9 * fine)
    image = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    image = 25 + image.astype(np.float64) * 0.7 + random.normal(0, 2.5, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def cpu_of_children_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def report(name, found, truths, seconds):
    errors = [np.linalg.norm(p - truths[k][i]) for k, view in enumerate(found) for i, p in view.items()]
    wrong = sum(e > 2 for e in errors)
    good = np.array([e for e in errors if e <= 2])
    seen = sum(bool(v) for v in found)
    print(
        f"  {name:24} {seen} of {IMAGES} images, {len(errors)} corners, {wrong} further than 2 px off, the others "
        f"{np.sqrt(np.mean(good**2)):.3f} px rms, {1 / seconds * IMAGES:.0f} images/s"
    )


for bits in (4, 5, 6):
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{bits}X{bits}_250"))
    board = cv2.aruco.CharucoBoard(SQUARES, SQUARE_M, MARKER_M, dictionary)
    drawing = board.generateImage((SQUARES[0] * PIXELS_PER_SQUARE, SQUARES[1] * PIXELS_PER_SQUARE), marginSize=0)
    points = np.array(board.getChessboardCorners())[:, :2] / SQUARE_M * PIXELS_PER_SQUARE - 0.5
    homographies = [pose() for _ in range(IMAGES)]
    images = [render(drawing, h) for h in homographies]
    truths = [cv2.perspectiveTransform(points.reshape(-1, 1, 2).astype(np.float64), h).reshape(-1, 2) for h in homographies]
    inside = sum(int(np.all((t > 4) & (t < np.array(SIZE) - 5), axis=1).sum()) for t in truths)
    print(f"{SQUARES[0]} × {SQUARES[1]} squares, {bits} × {bits} bits: {inside} corners inside {IMAGES} images of {SIZE[0]} × {SIZE[1]}")

    detector = cv2.aruco.CharucoDetector(board)
    start = time.process_time()
    found = []
    for image in images:
        corners, ids, _, _ = detector.detectBoard(image)
        pairs = [] if ids is None else zip(np.array(ids).reshape(-1), np.array(corners).reshape(-1, 2))
        found.append({int(i): p for i, p in pairs})
    report(f"OpenCV {cv2.__version__}", found, truths, time.process_time() - start)

    with tempfile.TemporaryDirectory() as folder:
        for k, image in enumerate(images):
            cv2.imwrite(str(Path(folder) / f"{k:03}.png"), image)
        words = [folder, "charuco", str(SQUARES[0]), str(SQUARES[1]), str(SQUARE_M), str(MARKER_M), f"{bits}x{bits}"]
        text = subprocess.run([ours, *words, "--corners"], capture_output=True, text=True, check=True).stdout
        # Reading left out: a fifth of the difference of six looks and one is looking alone.
        used = []
        for repeat in ("1", "6"):
            start = cpu_of_children_s()
            subprocess.run([ours, *words, "--repeat", repeat], capture_output=True, check=True)
            used.append(cpu_of_children_s() - start)
    found = [{} for _ in images]
    for line in text.splitlines()[:-1]:
        name, index, x, y = line.split()
        found[int(name[:3])][int(index)] = np.array([float(x), float(y)])
    report("lsfb", found, truths, (used[1] - used[0]) / 5)
