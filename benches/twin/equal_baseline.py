"""Descriptor distances of true matches at equal baseline: rendered and real images, by the angle between the two rays of a point.

`equal_baseline.py DATA FOLDER...`: folders written by the example `frames`, with different gaps between the images of a pair.
"""

import glob
import json
import os
import re
import sys

import cv2
import numpy as np

data, folders = sys.argv[1], sys.argv[2:]
WIDTH = 640.0
BINS_DEG = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0]
# An image meets those this many places further in its sequence.
REAL_STEPS = [1, 2, 3, 4, 6]
sift = cv2.SIFT_create()


def features(path, seen={}):
    """Keypoints in pixels of the file, and descriptors, both found in the image shrunk to WIDTH."""
    if path not in seen:
        grey = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        scale = WIDTH / grey.shape[1]
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        points, descriptors = sift.detectAndCompute(grey, None)
        pixels = np.array([p.pt for p in points]).reshape(-1, 2)
        seen[path] = ((pixels + 0.5) / scale - 0.5, descriptors)
    return seen[path]


def pinhole(f, c):
    def rays(pixels):
        v = np.concatenate([(pixels - c) / f, np.ones((len(pixels), 1))], axis=1)
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    return rays


def lens(camera):
    f, c = camera["lens"]["focal_px"], camera["lens"]["principal_px"]
    k = np.array([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1.0]])
    d = np.array(camera["lens"]["distortion"], dtype=float)
    undistort = cv2.fisheye.undistortPoints if camera["lens"]["model"] == "kannala-brandt" else cv2.undistortPoints

    def rays(pixels):
        flat = undistort(pixels.reshape(-1, 1, 2), k, d).reshape(-1, 2)
        v = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    return rays


def matches(pair, rays, focal_px):
    """Angles in degrees between the rays of each true match, distances of their descriptors, and how many matches are wrong."""
    a, b, rotation, t = pair
    (pa, da), (pb, db) = features(a), features(b)
    if da is None or db is None or len(da) < 8 or len(db) < 8:
        return [], [], 0
    forth = cv2.BFMatcher().knnMatch(da, db, k=2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(db, da)}
    good = [m for m, n in forth if m.distance < 0.8 * n.distance and back.get(m.trainIdx) == m.queryIdx]
    if not good:
        return [], [], 0
    ra = rays(pa[[m.queryIdx for m in good]]) @ rotation.T
    rb = rays(pb[[m.trainIdx for m in good]])
    normal = np.cross(t, ra)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    # Poses of real sets are good to some tenths of a degree.
    on_line = np.abs(np.sum(normal * rb, axis=1)) < 3.0 / focal_px
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(ra, rb), axis=1), np.sum(ra * rb, axis=1)))
    # A point λa·ra + t = λb·rb lies in front of both images.
    apart = np.cross(ra, rb)
    in_front = (np.sum(np.cross(t, rb) * apart, axis=1) <= 0) & (np.sum(np.cross(t, ra) * apart, axis=1) <= 0)
    keep = on_line & (in_front | (angle < 0.5))
    return angle[keep], np.array([m.distance for m in good])[keep], np.count_nonzero(~keep)


def describe(name, pairs, rays, focal_px):
    angles, distances, wrong = [], [], 0
    for pair in pairs:
        a, d, w = matches(pair, rays, focal_px)
        angles += list(a)
        distances += list(d)
        wrong += w
    angles, distances = np.array(angles), np.array(distances)
    cells = []
    for low, high in zip(BINS_DEG, BINS_DEG[1:]):
        inside = distances[(angles >= low) & (angles < high)]
        cells.append(f"{np.median(inside):.0f} ({len(inside)})" if len(inside) >= 50 else "–")
    share = wrong / max(1, wrong + len(angles))
    print(f"| {name} | " + " | ".join(cells) + f" | {100 * share:.0f} % |", flush=True)


def real(pairs_of, poses):
    out = []
    for i in range(len(poses)):
        for step in REAL_STEPS:
            if i + step < len(poses):
                b_from_a = np.linalg.inv(poses[i + step]) @ poses[i]
                out.append((pairs_of[i], pairs_of[i + step], b_from_a[:3, :3], b_from_a[:3, 3]))
    return out


bins = " | ".join(f"{a:.0f}–{b:.0f}°" for a, b in zip(BINS_DEG, BINS_DEG[1:]))
print(f"| images | {bins} | wrong |")
print("| --- |" + " --- |" * len(BINS_DEG))

office = os.path.join(data, "vision/hololens_office")
if os.path.isdir(office):
    k = np.loadtxt(os.path.join(office, "K.txt"))
    lines = [line.split() for line in open(os.path.join(office, "poses_T_world_cam_rowmajor4x4.txt")) if line.strip() and line[0] != "#"]
    lines = lines[::3]
    files = [os.path.join(office, "images", os.path.basename(line[0])) for line in lines]
    poses = [np.array(line[1:17], dtype=float).reshape(4, 4) for line in lines]
    describe("real: HoloLens, office", real(files, poses), pinhole(np.array([k[0, 0], k[1, 1]]), k[:2, 2]), k[0, 0])
kitchen = os.path.join(data, "vision/sevenscenes_redkitchen")
if os.path.isdir(kitchen):
    files = sorted(glob.glob(os.path.join(kitchen, "**/*color*"), recursive=True))
    poses = [np.loadtxt(re.sub(r"\.color\.\w+$", ".pose.txt", f)) for f in files]
    describe("real: 7-Scenes, kitchen", real(files, poses), pinhole(np.array([525.0, 525.0]), np.array([320.0, 240.0])), 525.0)
for name in sorted({os.path.basename(p)[:-5] for f in folders for p in glob.glob(os.path.join(f, "*.json"))}):
    pairs, rays = [], None
    for folder in folders:
        path = os.path.join(folder, f"{name}.json")
        truth = json.load(open(path)) if os.path.exists(path) else {}
        for pair in truth.get("pairs", []):
            m = np.array(pair["b_from_a"])
            pairs.append((os.path.join(folder, pair["a"]), os.path.join(folder, pair["b"]), m[:, :3], m[:, 3]))
            rays, focal = lens(truth["camera"]), truth["camera"]["lens"]["focal_px"][0]
    if pairs:
        describe(f"twin: {name}", pairs, rays, focal)
