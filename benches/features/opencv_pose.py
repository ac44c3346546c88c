"""OpenCV's findEssentialMat and recoverPose on matches that `lsfb bench features --keep-images` wrote: opencv_pose.py MATCHES.json

Prints the area below recall over error at 5, 10 and 20 degrees, theirs and ours, on the same matches.
"""

import json
import sys

import cv2
import numpy as np

LIMITS = (5.0, 10.0, 20.0)


def angle_deg(cosine):
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def normalised(pixels, pinhole):
    fx, fy, cx, cy = pinhole
    return (np.asarray(pixels) - [cx, cy]) / [fx, fy]


def error_deg(pair, threshold_px):
    matches = np.asarray(pair["matches"], float).reshape(-1, 2, 2)
    if len(matches) < 6:
        return np.inf
    first, second = (normalised(matches[:, k], pair["pinholes"][k]) for k in (0, 1))
    focal = np.mean([p[:2] for p in pair["pinholes"]])
    cv2.setRNGSeed(1)
    essentials, mask = cv2.findEssentialMat(
        first, second, np.eye(3), method=cv2.RANSAC, prob=0.9999, threshold=threshold_px / focal, maxIters=5000
    )
    if essentials is None:
        return np.inf
    truth = np.asarray(pair["second_from_first"])
    best = (-1, np.inf)
    for k in range(0, len(essentials), 3):
        essential = essentials[k : k + 3]
        inliers, rotation, translation, _ = cv2.recoverPose(essential, first, second, np.eye(3), mask=mask.copy())
        turn = angle_deg((np.trace(rotation.T @ truth[:, :3]) - 1) / 2)
        direction = truth[:, 3] / np.linalg.norm(truth[:, 3])
        aside = angle_deg(float(translation[:, 0] @ direction))
        best = max(best, (inliers, -max(turn, aside))) if best[0] >= 0 else (inliers, -max(turn, aside))
    return -best[1]


def areas(errors):
    errors = np.sort([np.inf if e is None else e for e in errors])
    recall = (np.arange(len(errors)) + 1) / len(errors)
    errors, recall = np.r_[0.0, errors], np.r_[0.0, recall]
    found = []
    for limit in LIMITS:
        last = np.searchsorted(errors, limit)
        found.append(np.trapezoid(np.r_[recall[:last], recall[last - 1]], np.r_[errors[:last], limit]) / limit)
    return " ".join(f"{100 * a:.1f}" for a in found)


def main():
    pairs = json.load(open(sys.argv[1]))
    print(f"{len(pairs)} pairs; AUC at 5, 10, 20 degrees")
    print("ours:", areas([p["error_deg"] for p in pairs]))
    for threshold_px in (0.75, 1.0, 1.5):
        print(f"OpenCV {cv2.__version__}, {threshold_px} px:", areas([error_deg(p, threshold_px) for p in pairs]))


if __name__ == "__main__":
    main()
