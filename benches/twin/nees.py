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
    rows = np.loadtxt(path, ndmin=2)
    return rows[:, 0], rows[:, 1:4], Rotation.from_quat(rows[:, 4:8])


def placed(truth, times):
    """Positions and attitudes of a trajectory at times; those outside it are left out, and which remain is said."""
    within = (times >= truth[0][0]) & (times <= truth[0][-1])
    seen = times[within]
    return within, np.column_stack([np.interp(seen, truth[0], truth[1][:, i]) for i in range(3)]), Slerp(truth[0], truth[2])(seen)


def laid_on(estimate, truth):
    """Rotation and shift that lay the positions of one trajectory on those of another."""
    within, other, _ = placed(truth, estimate[0])
    own = estimate[1][within]
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
        within, there, true_attitudes = placed(poses(f"{folder}/truth/truth_walk.tum"), times)
        # In the map's world, as the covariances are.
        off = (there - (places[within] @ turn.T + shift)) @ turn
        turned = (true_attitudes * (Rotation.from_matrix(turn) * attitudes[within]).inv()).as_rotvec() @ turn
        stated = np.loadtxt(path, ndmin=2)[within, 8:44].reshape(-1, 6, 6)
        found = {3: squared(off, stated[:, :3, :3]), 6: squared(np.hstack([off, turned]), stated)}
        for freedom, values in found.items():
            shares[freedom].append(np.mean(values < WITHIN[freedom]))
        sigma = np.sqrt(np.trace(stated[:, :3, :3], axis1=1, axis2=2).mean())
        print(
            f"{os.path.relpath(folder, trial):40} {len(off):4} poses, {100 * np.sqrt((off**2).sum(1).mean()):5.2f} cm off, σ {100 * sigma:5.2f} cm;"
            f" positions {found[3].mean() / 3:5.2f}, {100 * shares[3][-1]:5.1f} % within; poses {found[6].mean() / 6:5.2f}, {100 * shares[6][-1]:5.1f} %"
        )
if not shares[6]:
    sys.exit("no walk has a covariance there: name folders of `lsfb bench twin`")
print(f"{len(shares[6])} walks: positions {100 * np.mean(shares[3]):.1f} %, poses {100 * np.mean(shares[6]):.1f} % within the region of 95 %")
