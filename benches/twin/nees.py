"""Whether the covariances of walks in a map are as large as their errors: normalised squared errors over a trial's folder.

usage: nees.py TRIAL...     folders of `lsfb bench twin`

The map is laid on the truth by the trajectory of its scan; walks are compared with the truth where they are, nothing is aligned.
Of each walk: how far it is off, its stated standard deviation, the mean squared error in units of the stated covariance over its
degrees of freedom (1 where it is honest), and the share of poses within the region of 95 %, of positions alone and of whole poses.
"""

import glob
import os
import sys

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

# 95 % of chi squared with three and six degrees of freedom.
WITHIN = {3: 7.815, 6: 12.592}


def poses(path):
    rows = np.loadtxt(path)
    return rows[:, 0], rows[:, 1:4], Rotation.from_quat(rows[:, 4:8])


def laid_on(estimate, truth):
    """Rotation and shift that lay the positions of one trajectory on those of another."""
    times, places, _ = estimate
    after = np.searchsorted(truth[0], times).clip(1, len(truth[0]) - 1)
    near = np.where(abs(truth[0][after - 1] - times) < abs(truth[0][after] - times), after - 1, after)
    both = abs(truth[0][near] - times) < 2e-3
    own, other = places[both], truth[1][near][both]
    u, _, vt = np.linalg.svd((own - own.mean(0)).T @ (other - other.mean(0)))
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return turn, other.mean(0) - turn @ own.mean(0)


def squared(errors, covariances):
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)


shares = {3: [], 6: []}
for trial in sys.argv[1:]:
    for path in sorted(glob.glob(f"{trial}/*/*-as-scanned/walk_covariance.txt")):
        folder = os.path.dirname(path)
        scan = poses(f"{os.path.dirname(folder)}/scan.tum")
        turn, shift = laid_on(scan, poses(f"{folder}/truth/truth_scan.tum"))
        times, places, attitudes = poses(path)
        true_times, true_places, true_attitudes = poses(f"{folder}/truth/truth_walk.tum")
        seen = times.clip(true_times[0], true_times[-1])
        there = np.column_stack([np.interp(seen, true_times, true_places[:, i]) for i in range(3)])
        # In the map's world, as the covariances are.
        off = (there - (places @ turn.T + shift)) @ turn
        turned = (Slerp(true_times, true_attitudes)(seen) * (Rotation.from_matrix(turn) * attitudes).inv()).as_rotvec() @ turn
        stated = np.loadtxt(path)[:, 8:44].reshape(-1, 6, 6)
        found = {3: squared(off, stated[:, :3, :3]), 6: squared(np.hstack([off, turned]), stated)}
        for freedom, values in found.items():
            shares[freedom].append(np.mean(values < WITHIN[freedom]))
        sigma = np.sqrt(np.trace(stated[:, :3, :3], axis1=1, axis2=2).mean())
        print(
            f"{os.path.relpath(folder, trial):40} {len(times):4} poses, {100 * np.sqrt((off**2).sum(1).mean()):5.2f} cm off, σ {100 * sigma:5.2f} cm;"
            f" positions {found[3].mean() / 3:5.2f}, {100 * shares[3][-1]:5.1f} % within; poses {found[6].mean() / 6:5.2f}, {100 * shares[6][-1]:5.1f} %"
        )
print(f"{len(shares[6])} walks: positions {100 * np.mean(shares[3]):.1f} %, poses {100 * np.mean(shares[6]):.1f} % within the region of 95 %")
