"""How hard each environment is: keypoints, matches between neighbours, wrong ones by the true epipolar geometry."""

import glob
import json
import os
import sys

import cv2
import numpy as np

folder = sys.argv[1]
sift = cv2.SIFT_create()


def rays(points, camera):
    lens = camera["lens"]
    f, c = lens["focal_px"], lens["principal_px"]
    k = np.array([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1.0]])
    d = np.array(lens["distortion"], dtype=float)
    points = points.reshape(-1, 1, 2).astype(float)
    if lens["model"] == "kannala-brandt":
        flat = cv2.fisheye.undistortPoints(points, k, d)
    else:
        flat = cv2.undistortPoints(points, k, d)
    v = np.concatenate([flat.reshape(-1, 2), np.ones((len(points), 1))], axis=1)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


print("| sequence | keypoints | matches | wrong | images with < 35 keypoints | pairs with < 35 right matches |")
print("| --- | --- | --- | --- | --- | --- |")
for path in sorted(glob.glob(os.path.join(folder, "*.json"))):
    truth = json.load(open(path))
    if "pairs" not in truth:
        continue
    counts, matched, wrong, right = [], [], [], []
    for pair in truth["pairs"]:
        a, b = [
            sift.detectAndCompute(cv2.imread(os.path.join(folder, pair[k]), 0), None)
            for k in "ab"
        ]
        counts += [len(a[0]), len(b[0])]
        if a[1] is None or b[1] is None or len(b[0]) < 2 or len(a[0]) < 2:
            matched.append(0)
            right.append(0)
            continue
        forth = cv2.BFMatcher().knnMatch(a[1], b[1], k=2)
        back = cv2.BFMatcher().match(b[1], a[1])
        returned = {m.queryIdx: m.trainIdx for m in back}
        good = [
            m for m, n in forth if m.distance < 0.8 * n.distance and returned.get(m.trainIdx) == m.queryIdx
        ]
        matched.append(len(good))
        if not good:
            right.append(0)
            continue
        ra = rays(np.array([a[0][m.queryIdx].pt for m in good]), truth["camera"])
        rb = rays(np.array([b[0][m.trainIdx].pt for m in good]), truth["camera"])
        pose = np.array(pair["b_from_a"])
        turned = ra @ pose[:, :3].T
        t = pose[:, 3]
        if np.linalg.norm(t) > 0.02:
            normal = np.cross(t, turned)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
            off = np.abs((normal * rb).sum(axis=1))
            # Beyond what the way walked can explain, too.
            off = np.maximum(off, (np.linalg.norm(turned - rb, axis=1) > 0.5) * 1.0)
        else:
            off = np.linalg.norm(turned - rb, axis=1)
        bad = off > np.radians(0.5)
        wrong.append(bad.mean())
        right.append(int((~bad).sum()))
    counts, right = np.array(counts), np.array(right)
    print(
        f"| {os.path.basename(path)[:-5]} | {counts.mean():.0f} ({counts.min()}–{counts.max()}) | {np.mean(matched):.0f} | "
        f"{100 * np.mean(wrong) if wrong else float('nan'):.1f} % | {100 * (counts < 35).mean():.0f} % | {100 * (right < 35).mean():.0f} % |"
    )
