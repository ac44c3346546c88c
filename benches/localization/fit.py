"""Weights of a localization's evidence, fitted on the table of `localization_acceptance --csv`.

Usage: fit.py TABLE.csv

Prints the weights fitted on each place alone, with what they do on the others, and on all of them. Needs NumPy.
"""

import csv
import sys

import numpy as np

RIDGE = 0.03
RIGHT_M = {"office": 0.5, "kitchen": 0.5, "fountain": 1.0}
RIGHT_DEG = 10.0
ACCEPTED = 0.99
OWN_VIEWS = ("left out", "turned by 180°", "half size")
FOREIGN = ("mirrored", "another place")


def evidence(row):
    """What pipeline/src/localization/acceptance.rs weighs, bounded as there."""
    guided, decoys = float(row["guided_inliers"]), float(row["decoy_inliers"])
    return [
        1.0,
        np.clip(-float(row["log10_false_alarms"]), -10, 20),
        np.clip(np.log((guided + 1) / (decoys + 1)), 0, 2),
        min(float(row["image_spread"]), 0.4),
    ]


def is_right(row):
    distance_m, angle_deg = float(row["distance_m"]), float(row["angle_deg"])
    return distance_m <= RIGHT_M[row["place"]] and angle_deg <= RIGHT_DEG


def fit(terms, right):
    """Logistic regression with a ridge on all weights but the constant, in units of the terms' standard deviations."""
    scale = terms.std(0)
    scale[0] = 1.0
    scaled = terms / scale
    weights = np.zeros(terms.shape[1])
    ridge = np.full(len(weights), RIDGE)
    ridge[0] = 1e-9
    for _ in range(200):
        probability = 1 / (1 + np.exp(-scaled @ weights))
        gradient = scaled.T @ (probability - right) + ridge * weights
        spread = probability * (1 - probability)
        weights -= np.linalg.solve((scaled.T * spread) @ scaled + np.diag(ridge), gradient)
    return weights / scale


def main():
    with open(sys.argv[1], encoding="utf-8") as table:
        rows = [row for row in csv.DictReader(table) if row["first_matches"]]
    terms = np.array([evidence(row) for row in rows])
    right = np.array([is_right(row) for row in rows], float)
    place = np.array([row["place"] for row in rows])
    kind = np.array([row["kind"] for row in rows])
    alarms = 10.0 ** np.minimum([float(row["log10_false_alarms"]) for row in rows], 9)
    rival = np.array([float(row["rival_inliers"]) / max(float(row["first_inliers"]), 1) for row in rows])
    for fitted_on in ("office", "kitchen", None):
        used = place == fitted_on if fitted_on else np.ones(len(rows), bool)
        judged = ~used if fitted_on else used
        weights = fit(terms[used], right[used])
        probability = 1 / (1 + np.exp(-terms @ weights)) / (1 + alarms) / (1 + rival**6)
        accepted = probability >= ACCEPTED
        own, foreign = judged & np.isin(kind, OWN_VIEWS), judged & np.isin(kind, FOREIGN)
        print(
            f"fitted on {fitted_on or 'all'} ({used.sum()} queries): {weights.round(3)}; judged on "
            f"{'the others' if fitted_on else 'the same'}: {(accepted & judged & (right == 0)).sum()} of "
            f"{(accepted & judged).sum()} accepted are wrong, {(~accepted & own).sum()} of {own.sum()} own views missed, "
            f"{(accepted & foreign).sum()} of {foreign.sum()} foreign ones accepted"
        )


if __name__ == "__main__":
    main()
