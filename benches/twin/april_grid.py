"""Corners of the rendered AprilGrid as foreign detectors find them, against the truth.

usage: april_grid.py FOLDER     what `frames FOLDER calibration` wrote

Two detectors: PyPI `aprilgrid`, of which no corner is left out, and OpenCV's ArUco, whose corners are refined by
`cornerSubPix`. A refinement that depends on where it starts has no corner to go to (a neighbouring one is in its window):
such corners are left out, by what the refinement does alone, without a look at the truth.
"""

import json
import os
import sys

import cv2
import numpy as np

folder = sys.argv[1]
# Tags smaller than this leave the refinement no window, pixels.
SMALLEST_PX = 40
# Starts of the refinement around a corner that was found, pixels, and how far its ends may be apart.
STARTS = [(0, 0), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)]
APART_PX = 0.1
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)

parameters = cv2.aruco.DetectorParameters()
parameters.markerBorderBits = 2
aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), parameters)


def by_aruco(grey):
    found, ids, _ = aruco.detectMarkers(grey)
    # OpenCV draws the family upside down: its first corner is our lower right one.
    return [] if ids is None else [(int(tag), c[0][[1, 0, 3, 2]]) for c, tag in zip(found, ids.ravel())]


def by_aprilgrid():
    from aprilgrid import Detector

    detector = Detector("t36h11")
    return lambda grey: [(int(d.tag_id), np.array(d.corners, dtype=np.float32).reshape(4, 2)) for d in detector.detect(grey)]


def refined(grey, corners):
    """Where the refinement ends from each start."""
    half = int(np.clip(np.linalg.norm(corners[0] - corners[1]) / 14, 2, 6))
    ends = []
    for start in STARTS:
        begin = (corners + np.float32(start)).astype(np.float32).copy()
        ends.append(cv2.cornerSubPix(grey, begin, (half, half), (-1, -1), STOP))
    return np.array(ends)


def describe(name, kind, errors, kept):
    errors, kept = np.array(errors), np.array(kept)
    if len(errors) == 0:
        print(f"{name}, {kind}: none found")
        return
    length = np.linalg.norm(errors, axis=1)
    good = length[kept]
    mean = errors[kept].mean(axis=0)
    print(
        f"{name}, {kind}: {len(errors)} corners, {100 * (1 - kept.mean()):.1f} % left out; rms {np.sqrt((good**2).mean()):.3f} px, "
        f"per axis {np.sqrt((good**2).mean() / 2):.3f} px, mean ({mean[0]:+.3f}, {mean[1]:+.3f}) px, median {np.median(good):.3f} px, "
        f"95 % {np.percentile(good, 95):.3f} px, largest {good.max():.2f} px"
    )


images = json.load(open(os.path.join(folder, "calibration.json")))["images"]
detectors = {"ArUco + cornerSubPix": by_aruco}
try:
    detectors["aprilgrid"] = by_aprilgrid()
except ImportError:
    print("aprilgrid is not installed: pip install aprilgrid")
for name, detect in detectors.items():
    errors, kept = {}, {}
    for image in images:
        grey = cv2.imread(os.path.join(folder, image["file"]), cv2.IMREAD_GRAYSCALE)
        for tag, corners in detect(grey):
            truth = image["corners"].get(str(tag))
            if truth is None:
                continue
            truth = np.array(truth)
            if name == "aprilgrid":
                # Which corner is its first is a convention: the order that fits best is taken for the whole tag.
                orders = [np.roll(np.arange(4)[::d], k) for d in (1, -1) for k in range(4)]
                corners = min((corners[o] for o in orders), key=lambda c: np.abs(c - truth).sum())
            if np.linalg.norm(corners[0] - corners[1]) < SMALLEST_PX:
                continue
            if name == "aprilgrid":
                found, sure = corners, np.ones(4, bool)
            else:
                ends = refined(grey, corners)
                found, sure = ends[0], np.linalg.norm(ends - ends[0], axis=2).max(axis=0) < APART_PX
            errors.setdefault(image["kind"], []).extend(found - truth)
            kept.setdefault(image["kind"], []).extend(sure)
    for kind in errors:
        describe(name, kind, errors[kind], kept[kind])
