"""A street in BAL format: cameras walk two laps round a ring, house fronts outside it.

    python3 street.py CAMERAS POINTS OUT.txt

As `../shared/probes/gen.py`, with the start at a bounded distance from the truth. There a camera turns about the origin of the
world, so that its centre is off by its angle times the radius of the ring, 20 cm and more; steps are 50 cm, and what two
neighbours see of a point is a direction hardly better than none. Outliers of 90 pixels put points of two views at infinity.
Nobody comes down from there in 50 iterations, and the figure would be the number of iterations. Here cameras turn about
themselves, tracks have three views or more with two degrees between them, and outliers are within 10 pixels.
"""
import sys

import numpy as np

STEP_M, FOCAL_PX, LONGEST = 0.5, 800.0, 40
rng = np.random.default_rng(1)


def rotation(vectors):
    angle = np.linalg.norm(vectors, axis=1)[:, None, None] + 1e-300
    axis = vectors / angle[:, :, 0]
    cross = np.zeros((len(vectors), 3, 3))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        cross[:, j, i], cross[:, i, j] = axis[:, k], -axis[:, k]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def rotation_vectors(matrices):
    """Through the quaternion, which is well conditioned up to half a turn."""
    trace = np.trace(matrices, axis1=1, axis2=2)
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    candidates = np.concatenate((trace[:, None], diagonal), axis=1)
    out = np.empty((len(matrices), 3))
    for n, (R, k) in enumerate(zip(matrices, candidates.argmax(axis=1))):
        if k == 0:
            q = np.array([1 + trace[n], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        else:
            a, b, c = k - 1, k % 3, (k + 1) % 3
            q = np.empty(4)
            q[0] = R[c, b] - R[b, c]
            q[1 + a], q[1 + b], q[1 + c] = 1 + R[a, a] - R[b, b] - R[c, c], R[a, b] + R[b, a], R[a, c] + R[c, a]
        q /= np.copysign(np.linalg.norm(q), q[0])
        sine = np.linalg.norm(q[1:])
        out[n] = q[1:] * (2 * np.arctan2(sine, q[0]) / sine if sine > 1e-12 else 2.0)
    return out


cameras, wanted, path = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
lap = cameras // 2
radius = lap * STEP_M / (2 * np.pi)
angle = np.arange(cameras) * (2 * np.pi / lap)
centre = np.stack((radius * np.cos(angle), radius * np.sin(angle), 1.5 + 0.1 * np.sin(7 * angle)), axis=1)
yaw = angle + np.where(np.arange(cameras) % 2, 0.5, -0.5)
forward = np.stack((np.cos(yaw), np.sin(yaw), 0.05 * np.sin(3 * angle + np.arange(cameras))), axis=1)
forward /= np.linalg.norm(forward, axis=1)[:, None]
right = np.cross(forward, (0.0, 0.0, 1.0))
right /= np.linalg.norm(right, axis=1)[:, None]
camera_from_world = np.stack((right, np.cross(right, forward), -forward), axis=1)

# Points in the order of the street. Each is seen by a run of cameras about the one it is nearest to, of one lap or both.
where = np.sort(rng.uniform(0, 2 * np.pi, wanted))
far = radius + rng.uniform(6, 20, wanted)
points = np.stack((far * np.cos(where), far * np.sin(where), rng.uniform(0, 8, wanted)), axis=1)
kept, rows = 0, []
kept_points = []
for first in range(0, wanted, 20000):
    part = slice(first, min(first + 20000, wanted))
    count = part.stop - first
    laps = rng.integers(0, 2, count)
    both = rng.random(count) < 0.2
    ids, seen_by, pixels, rays = [], [], [], []
    for again in (0, 1):
        length = np.minimum(rng.geometric(0.18, count) + 3, LONGEST)
        start = np.round(where[part] * lap / (2 * np.pi)).astype(int) + rng.integers(-6, 7, count) - length // 2
        run = start[:, None] + np.arange(LONGEST)
        camera = run % lap + lap * ((laps + again) % 2)[:, None]
        offset = points[part][:, None, :] - centre[camera]
        p = np.einsum("nkij,nkj->nki", camera_from_world[camera], offset)
        u = -p[..., :2] / np.where(p[..., 2:] < -1, p[..., 2:], -1.0)
        ok = (p[..., 2] < -1) & (np.abs(u[..., 0]) < 0.8) & (np.abs(u[..., 1]) < 0.6) & (np.arange(LONGEST) < length[:, None])
        ok &= (np.ones(count, bool) if again == 0 else both)[:, None]
        n, k = np.nonzero(ok)
        ids.append(n)
        seen_by.append(camera[n, k])
        pixels.append(u[n, k])
        rays.append(offset[n, k] / np.linalg.norm(offset[n, k], axis=1)[:, None])
    ids, seen_by, pixels, rays = map(np.concatenate, (ids, seen_by, pixels, rays))
    order = np.lexsort((seen_by, ids))
    ids, seen_by, pixels, rays = ids[order], seen_by[order], pixels[order], rays[order]
    views = np.bincount(ids, minlength=count)
    begin = np.concatenate(([0], np.cumsum(views)))[:-1]
    parallax = np.zeros(count)
    np.maximum.at(parallax, ids, np.linalg.norm(rays - rays[begin[ids]], axis=1))
    good = (views >= 3) & (parallax > np.radians(2.0))
    number = np.cumsum(good) - 1 + kept
    use = good[ids]
    n2 = (pixels**2).sum(axis=1)[:, None]
    measured = FOCAL_PX * (1 - 0.05 * n2 + 0.01 * n2**2) * pixels + rng.normal(0, 0.5, pixels.shape)
    outlier = rng.random(len(ids)) < 0.02
    measured += np.where(outlier[:, None], rng.uniform(-10, 10, pixels.shape), 0.0)
    rows += [
        f"{c} {i} {x:.6f} {y:.6f}\n"
        for c, i, (x, y) in zip(seen_by[use].tolist(), number[ids][use].tolist(), measured[use].tolist())
    ]
    kept_points.append(points[part][good])
    kept += int(good.sum())
kept_points = np.concatenate(kept_points) + rng.normal(0, 0.05, (kept, 3))
turned = rotation(rng.normal(0, 0.003, (cameras, 3))) @ camera_from_world
moved = centre + rng.normal(0, 0.02, (cameras, 3))
values = np.concatenate(
    (
        rotation_vectors(turned),
        -np.einsum("nij,nj->ni", turned, moved),
        FOCAL_PX + rng.normal(0, 4, (cameras, 1)),
        -0.05 + rng.normal(0, 0.01, (cameras, 1)),
        np.full((cameras, 1), 0.01),
    ),
    axis=1,
)
with open(path, "w") as file:
    file.write(f"{cameras} {kept} {len(rows)}\n")
    file.writelines(rows)
    file.writelines(f"{x:.12g}\n" for x in values.ravel().tolist())
    file.writelines(f"{x:.12g}\n" for x in kept_points.ravel().tolist())
print(cameras, kept, len(rows))
