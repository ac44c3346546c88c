"""Noise of an IMU from simulated logs at rest: `lsfb calib imu-noise` against what was put in, and its Allan deviations
against AllanTools on the same samples.

    python -m venv /tmp/noise && /tmp/noise/bin/pip install allantools
    /tmp/noise/bin/python benches/imu_noise/compare.py target/release/lsfb [SEEDS]
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import allantools
import numpy as np

RATE_HZ, SECONDS = 20, 7200
TRUTH = {"gyro": (1.6e-4, 1.5e-5), "accel": (2.8e-3, 2.0e-4)}
START = 1_772_359_200_000_000_000


def cpu_of_children_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def simulate(seed):
    """White noise and a bias that walks, three axes of each triad."""
    random = np.random.default_rng(seed)
    count = RATE_HZ * SECONDS
    columns = []
    for density, walk in TRUTH.values():
        bias = np.cumsum(random.normal(size=(count, 3)), axis=0) * walk / np.sqrt(RATE_HZ)
        columns.append(bias + density * np.sqrt(RATE_HZ) * random.normal(size=(count, 3)))
    return np.hstack(columns)


def main(lsfb, seeds):
    off = {"density": [], "walk": []}
    relative = {"density": [], "walk": []}
    apart, ours_s, theirs_s = 0.0, 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(1, seeds + 1):
            samples = simulate(seed)
            table = Path(folder) / "imu.csv"
            with open(table, "w") as out:
                for k, row in enumerate(samples):
                    stamp = START + k * 1_000_000_000 // RATE_HZ
                    out.write(f"{stamp}," + ",".join(repr(float(v)) for v in row) + "\n")
            began_s = cpu_of_children_s()
            command = [lsfb, "calib", "imu-noise", "--imu", table, "--out", Path(folder) / "noise.html", "--json"]
            found = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            ours_s += cpu_of_children_s() - began_s
            for triad, (density, walk) in TRUTH.items():
                for name, truth in (("density", density), ("walk", walk)):
                    error = found[triad][name] - truth
                    off[name].append(error / found[f"{triad}_sigma"][name])
                    relative[name].append(abs(error) / truth)
            for axis, samples_of_axis in zip(found["axes"], samples.T):
                taus = [c["time_s"] for c in axis["clusters"]]
                began_s = time.process_time()
                theirs = allantools.oadev(samples_of_axis, rate=RATE_HZ, data_type="freq", taus=taus)
                theirs_s += time.process_time() - began_s
                ours = np.sqrt([c["variance"] for c in axis["clusters"]])
                assert len(theirs[1]) == len(ours)
                apart = max(apart, float(np.max(np.abs(ours / theirs[1] - 1.0))))
    for name in off:
        rms = np.sqrt(np.mean(np.square(off[name])))
        print(f"{name}: worst error {100 * max(relative[name]):.2f} %, {rms:.2f} σ rms, {np.max(np.abs(off[name])):.2f} σ at most")
    print(f"Allan deviations: at most {100 * apart:.2f} % from AllanTools'")
    print(f"CPU per log: lsfb with reading and fits {ours_s / seeds:.2f} s, AllanTools' deviations alone {theirs_s / seeds:.2f} s")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 8)
