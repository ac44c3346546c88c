"""What evo needs without its start-up: CPU seconds in one Python process, for the figures that `lsfb eval` gives, and for two of them alone.

    python3 -m venv venv && venv/bin/pip install evo
    venv/bin/python evo_in_process.py t.tum e.tum        # writes both, 17 210 poses of a made-up walk, and measures
    perf stat -e task-clock lsfb --threads 1 eval e.tum --truth t.tum
    cargo run --release --workspace --example judge_17000 -- t.tum e.tum          # ours in one process likewise
"""

import copy
import sys
import time

import numpy as np
from evo.core import metrics, sync
from evo.tools import file_interface

POSES = 17_210
RELATION = metrics.PoseRelation


def write(path, stamps, positions, quaternions):
    with open(path, "w") as out:
        for row in np.c_[stamps, positions, quaternions]:
            out.write(" ".join(f"{value:.9f}" for value in row) + "\n")


def walk(k, noise):
    """Positions and quaternions (x, y, z, w) of yaw and pitch, with normal errors of 1 cm and 2 mrad where `noise` is a generator."""
    positions = np.c_[
        3 * np.sin(0.11 * k) + 0.02 * k * np.sin(0.001 * k), 4 * np.cos(0.083 * k), 0.3 * np.sin(0.5 * k) + 1.5
    ]
    yaw, pitch = 0.3 * k, 0.1 * np.sin(0.7 * k)
    if noise is not None:
        positions = positions + noise.normal(0, 0.01, positions.shape)
        yaw, pitch = yaw + noise.normal(0, 0.002, k.shape), pitch + noise.normal(0, 0.002, k.shape)
    (sy, cy), (sp, cp) = ((np.sin(a / 2), np.cos(a / 2)) for a in (yaw, pitch))
    return positions, np.c_[-sy * sp, cy * sp, sy * cp, cy * cp]


def figure(metric, pair):
    metric.process_data(pair)
    return metric.get_statistic(metrics.StatisticsType.rmse)


def judge(truth, estimate, all_figures):
    start = time.process_time()
    reference = file_interface.read_tum_trajectory_file(truth)
    found = file_interface.read_tum_trajectory_file(estimate)
    reference, found = sync.associate_trajectories(reference, found)
    relations = [RELATION.translation_part]
    figures = []
    if all_figures:
        figures.append(figure(metrics.APE(RELATION.translation_part), (reference, found)))
        scaled = copy.deepcopy(found)
        scaled.align(reference, correct_scale=True)
        figures.append(figure(metrics.APE(RELATION.translation_part), (reference, scaled)))
        relations += [RELATION.rotation_angle_deg]
    aligned = copy.deepcopy(found)
    aligned.align(reference)
    for relation in relations:
        figures.append(figure(metrics.APE(relation), (reference, aligned)))
    for relation in relations + ([RELATION.point_distance] if all_figures else []):
        figures.append(figure(metrics.RPE(relation, 1.0, metrics.Unit.meters), (reference, aligned)))
    return time.process_time() - start, figures


if __name__ == "__main__":
    truth, estimate = sys.argv[1:3]
    seconds = np.arange(POSES) * 0.05
    write(truth, 1.4e9 + seconds, *walk(seconds, None))
    write(estimate, 1.4e9 + seconds, *walk(seconds, np.random.default_rng(5)))
    for all_figures in (False, True):
        runs = sorted(judge(truth, estimate, all_figures) for _ in range(5))
        print("all figures" if all_figures else "ATE and RPE of translation", "%.3f s of CPU" % runs[2][0], runs[2][1])
