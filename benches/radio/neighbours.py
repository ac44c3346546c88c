"""Places by Wi-Fi on walks of Indoor Location 2.0, from the definition alone: what `lsfb bench radio` must say.

Usage: neighbours.py FOLDER_OF_TXT_OR_TXT_GZ. Needs nothing but Python.
"""

import gzip
import math
import pathlib
import statistics
import sys

FLOOR, EXPONENT, OLDEST_NS, NEIGHBOURS, SMALLEST, LONGEST_GAP_NS = -95.0, 1.5, 4_000_000_000, 3, 1e-3, 60_000_000_000


def place(waypoints, at):
    for (t0, x0, y0), (t1, x1, y1) in zip(waypoints, waypoints[1:]):
        if t0 <= at <= t1 and t1 - t0 <= LONGEST_GAP_NS:
            share = (at - t0) / (t1 - t0)
            return x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    return None


scans = []
for walk, path in enumerate(sorted(pathlib.Path(sys.argv[1]).glob("*.txt*"))):
    opened = gzip.open(path, "rt", errors="replace") if path.suffix == ".gz" else open(path, errors="replace")
    waypoints, handed = [], {}
    with opened as lines:
        for line in lines:
            cells = line.rstrip("\n").split("\t")
            if cells[1] == "TYPE_WAYPOINT":
                waypoints.append((int(cells[0]) * 10**6, float(cells[2]), float(cells[3])))
            elif cells[1] == "TYPE_WIFI":
                handed.setdefault(cells[0], []).append((int(cells[6]) * 10**6, cells[3], int(cells[4])))
    waypoints.sort()
    for readings in handed.values():
        placed = [(at, who, dbm, where) for at, who, dbm in readings if (where := place(waypoints, at))]
        if not placed:
            continue
        newest = max(at for at, *_ in placed)
        placed = [r for r in placed if newest - r[0] <= OLDEST_NS]
        heard = {}
        for _, who, dbm, _ in placed:
            heard[who] = max(heard.get(who, 0.0), max(0.0, dbm - FLOOR) ** EXPONENT)
        norm = math.sqrt(sum(v * v for v in heard.values()))
        if norm > 0:
            x, y = (statistics.fmean(r[3][axis] for r in placed) for axis in (0, 1))
            scans.append((walk, (x, y), {who: v / norm for who, v in heard.items()}))

errors, near = [], []
for walk, at, heard in scans:
    others = []
    for other, where, theirs in scans:
        if other != walk:
            others.append((1.0 - min(1.0, sum(v * theirs.get(who, 0.0) for who, v in heard.items())), where))
    near.append(min(math.dist(at, where) for _, where in others))
    best = [o for o in sorted(others, key=lambda o: o[0])[:NEIGHBOURS] if o[0] < 1.0]
    weights = [1.0 / (apart + SMALLEST) for apart, _ in best]
    found = [sum(w * where[axis] for w, (_, where) in zip(weights, best)) / sum(weights) for axis in (0, 1)]
    errors.append(math.dist(at, found))
for name, within in (("all", math.inf), ("5 m", 5.0), ("10 m", 10.0)):
    own = [e for e, n in zip(errors, near) if n < within]
    print(f"{name}: {len(own)} scans, mean {statistics.fmean(own):.6f}, median {statistics.median(own):.6f}, largest {max(own):.6f}")
