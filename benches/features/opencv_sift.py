"""OpenCV's SIFT in all images of a folder: usage: opencv_sift.py IMAGES OUT [FEATURES [CONTRAST]]

CONTRAST is OpenCV's contrastThreshold (0.04); 0.021 keeps keypoints as faint as ours.

Writes OUT/NNNN.txt (SIFT) and OUT-root/NNNN.txt (RootSIFT times 512): see README.md.
"""

import pathlib
import sys
import time

import cv2
import numpy as np


def write(path, milliseconds, keypoints, descriptors):
    lines = [f"cpu_ms {milliseconds:.3f}"]
    for k, d in zip(keypoints, descriptors):
        numbers = " ".join(str(int(v)) for v in d)
        lines.append(f"{k.pt[0]:.4f} {k.pt[1]:.4f} {k.size / 2:.3f} {numbers}")
    path.write_text("\n".join(lines) + "\n")


def main():
    images, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 900
    contrast = float(sys.argv[4]) if len(sys.argv) > 4 else 0.04
    root = out.with_name(out.name + "-root")
    out.mkdir(parents=True, exist_ok=True)
    root.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    sift = cv2.SIFT_create(nfeatures=count, contrastThreshold=contrast)
    total = []
    for path in sorted(images.glob("*.pgm")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        best = float("inf")
        for _ in range(2):
            begun = time.thread_time()
            keypoints, descriptors = sift.detectAndCompute(image, None)
            best = min(best, 1e3 * (time.thread_time() - begun))
        total.append(best)
        if descriptors is None:
            keypoints, descriptors = [], np.zeros((0, 128), np.float32)
        write(out / f"{path.stem}.txt", best, keypoints, np.clip(np.round(descriptors), 0, 255))
        sums = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
        rooted = np.clip(np.round(512 * np.sqrt(descriptors / sums)), 0, 255)
        write(root / f"{path.stem}.txt", best, keypoints, rooted)
    print(f"OpenCV {cv2.__version__}: {len(total)} images, median {np.median(total):.1f} ms CPU")


if __name__ == "__main__":
    main()
