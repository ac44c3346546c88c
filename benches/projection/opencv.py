"""Time of one projection with derivatives in OpenCV, one thread; beside the example `projection_speed`.

Recipe: python3 -m venv v && v/bin/pip install numpy opencv-contrib-python-headless && v/bin/python opencv.py
"""
import time

import cv2
import numpy as np

cv2.setNumThreads(1)
t = np.arange(10_000) * 0.001
points = np.stack([0.7 * np.sin(7.3 * t), 0.5 * np.cos(3.1 * t), 1.2 + 0.4 * np.sin(t)], 1).reshape(-1, 1, 3)
K = np.array([[350, 0, 321], [0, 352, 198.5], [0, 0, 1.0]])
zero = np.zeros(3)
for name, project in {
    "pinhole-radtan": lambda: cv2.projectPoints(points, zero, zero, K, np.array([-0.28, 0.07, 1e-3, -5e-4, -0.006])),
    "kannala-brandt": lambda: cv2.fisheye.projectPoints(points, zero, zero, K, np.array([0.01, -0.02, 0.005, -0.001])),
}.items():
    project()
    rounds = []
    for _ in range(200):
        start = time.perf_counter()
        project()
        rounds.append(time.perf_counter() - start)
    # the fastest round, as in the example
    print(f"{name:17} pixel and all derivatives {min(rounds) * 1e9 / len(points):.1f} ns")
