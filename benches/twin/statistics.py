"""Statistics of rendered and of real images side by side."""

import glob
import os
import re
import sys

import cv2
import numpy as np

frames, data = sys.argv[1:3]
sift = cv2.SIFT_create()


def slope(grey):
    """Exponent p of a power spectrum ∝ 1/f^p."""
    n = min(grey.shape)
    g = grey[:n, :n].astype(float)
    window = np.outer(np.hanning(n), np.hanning(n))
    power = np.abs(np.fft.fftshift(np.fft.fft2((g - g.mean()) * window))) ** 2
    y, x = np.indices(power.shape) - n // 2
    r = np.hypot(x, y).astype(int)
    mean = np.bincount(r.ravel(), power.ravel()) / np.bincount(r.ravel())
    f = np.arange(4, n // 4)
    return -np.polyfit(np.log(f), np.log(mean[4 : n // 4]), 1)[0]


def describe(name, pairs):
    rows = []
    true, false = [], []
    for a, b in pairs:
        images = []
        for path in (a, b):
            grey = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
            scale = 640.0 / grey.shape[1]
            images.append(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
        features = [sift.detectAndCompute(g, None) for g in images]
        g = images[0]
        gx, gy = cv2.Sobel(g, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(g, cv2.CV_32F, 0, 1) / 8
        gradient = np.hypot(gx, gy)
        rows.append(
            [
                len(features[0][0]) / g.size * 1e6,
                np.median(gradient),
                np.percentile(gradient, 95),
                g.mean(),
                g.std(),
                slope(g),
            ]
        )
        if any(f[1] is None or len(f[0]) < 8 for f in features):
            continue
        matches = cv2.BFMatcher().knnMatch(features[0][1], features[1][1], k=2)
        pa = np.float32([features[0][0][m.queryIdx].pt for m, _ in matches])
        pb = np.float32([features[1][0][m.trainIdx].pt for m, _ in matches])
        first = np.array([m.distance for m, _ in matches])
        second = np.array([n.distance for _, n in matches])
        sure = first < 0.75 * second
        if sure.sum() < 12:
            continue
        _, mask = cv2.findFundamentalMat(pa[sure], pb[sure], cv2.FM_RANSAC, 2.0, 0.999)
        if mask is None:
            continue
        keep = np.flatnonzero(sure)[mask.ravel() > 0]
        true += list(first[keep])
        false += list(second[keep])
    r = np.median(np.array(rows), axis=0)
    print(
        f"| {name} | {len(pairs)} | {r[0]:.0f} | {np.median(true) if true else float('nan'):.0f} | "
        f"{np.median(false) if false else float('nan'):.0f} | {r[1]:.1f} | {r[2]:.1f} | {r[3]:.0f} ± {r[4]:.0f} | {r[5]:.2f} |"
    )


def sequence(pattern, step, count):
    files = glob.glob(os.path.join(data, pattern), recursive=True)
    files.sort(key=lambda p: [int(d) for d in re.findall(r"\d+", os.path.basename(p))])
    last = len(files) - step
    return [(files[k], files[k + step]) for k in range(0, max(last, 0), max(1, last // count))][:count]


print("| images | pairs | keypoints per Mpx | distance, true match | next best | gradient, median | 95 % | brightness | slope of spectrum |")
print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
for name, pattern, step in [
    ("real: HoloLens, office", "vision/hololens_office/**/*.jpg", 1),
    ("real: TUM VI, calibration room", "vision/tumvi_calib_imu1/mav0/cam0/data/*", 2),
    ("real: Hilti, construction site", "lidar/gtsfm_hilti/**/*.jpg", 5),
    ("real: 7 scenes, kitchen", "vision/sevenscenes_redkitchen/**/*color*", 3),
]:
    pairs = sequence(pattern, step, 16)
    if pairs:
        describe(name, pairs)
names = sorted({os.path.basename(p).split("-")[0] for p in glob.glob(os.path.join(frames, "*-a.png"))})
for name in names:
    files = sorted(glob.glob(os.path.join(frames, f"{name}-*-a.png")))
    describe(f"twin: {name}", [(f, f.replace("-a.png", "-b.png")) for f in files])
