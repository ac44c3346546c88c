"""Corners of the rendered AprilGrid as OpenCV's ArUco detector finds them, against the truth."""

import json
import os
import sys

import cv2
import numpy as np

folder = sys.argv[1]
parameters = cv2.aruco.DetectorParameters()
parameters.markerBorderBits = 2
detector = cv2.aruco.ArucoDetector(
    cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), parameters
)
errors = {}
for image in json.load(open(os.path.join(folder, "calibration.json")))["images"]:
    grey = cv2.imread(os.path.join(folder, image["file"]), cv2.IMREAD_GRAYSCALE)
    found, ids, _ = detector.detectMarkers(grey)
    if ids is None:
        continue
    for corners, tag in zip(found, ids.ravel()):
        truth = image["corners"].get(str(tag))
        if truth is None:
            continue
        # OpenCV draws the family upside down: its first corner is our lower right one.
        truth = np.array([truth[1], truth[0], truth[3], truth[2]])
        edge = np.linalg.norm(truth[0] - truth[1])
        half = int(np.clip(edge / 14, 2, 6))
        refined = cv2.cornerSubPix(
            grey,
            corners[0].copy(),
            (half, half),
            (-1, -1),
            (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4),
        )
        if edge > 40:
            errors.setdefault(image["kind"], []).extend(refined - truth)
for kind, e in errors.items():
    e = np.array(e)
    length = np.linalg.norm(e, axis=1)
    good = length < 1.0
    print(
        f"{kind}: {len(e)} corners, {good.mean():.4f} within 1 px; of those rms {np.sqrt((length[good] ** 2).mean()):.3f} px, "
        f"per axis {np.sqrt((length[good] ** 2).mean() / 2):.3f} px, mean ({e[good, 0].mean():+.3f}, {e[good, 1].mean():+.3f}) px, "
        f"median {np.median(length):.3f} px"
    )
