"""Weights of a localization's evidence, fitted on the tables of `localization_acceptance --csv`.

Usage: fit.py TABLE.csv [TABLE.csv ...]

Prints the weights fitted on each place alone, with what they do on the others, and on all of them. Views through a camera
whose focal length is not the stated one take no part in the fit: the localizer names them apart. Needs NumPy.
"""

import csv
import sys

import numpy as np

RIDGE = 0.03
RIGHT_M = {"office": 0.5, "kitchen": 0.5, "fountain": 1.0}
RIGHT_DEG = 10.0
ACCEPTED = 0.99
OWN_VIEWS = ("left out", "turned by 180°", "half size", "focal length -2 %", "focal length +2 %")
THINNED = ("every 10th feature", "every 30th feature")
FOREIGN = ("mirrored", "another place")
WRONG_CAMERA = ("half size in a frame", "focal length -20 %", "focal length -10 %", "focal length +10 %",
                "focal length +25 %", "focal length +100 %")
# What pipeline/src/localization/outcome.rs and acceptance.rs take for a focal length that does not fit.
FOCAL_LOG, FOCAL_SIGMAS, FOCAL_DECADES = 0.05, 3.0, 3.0
FAR_LOG, FAR_DECADES = 0.035, 12.0
DECADES_TOGETHER = {"sift": 0.028}
DECADES_TOGETHER_LEARNED = 0.075
OF_ONE_THING = 20.0
TWIN_SHARE = 1.5


def evidence(row):
    """What pipeline/src/localization/acceptance.rs weighs, bounded as there."""
    guided, decoys = float(row["guided_inliers"]), float(row["decoy_inliers"])
    return [
        1.0,
        np.clip(-float(row["log10_false_alarms"]), -10, 20),
        np.clip(np.log((guided + 1) / (decoys + 1)), 0, 2),
        min(float(row["image_spread"]), 0.4),
    ]


def against_likeness(row):
    """Probability that the matches are not wrong together, as many as they are and as few, and that no mirror explains them better."""
    false_alarms = float(row["log10_false_alarms"])
    decades = max(-false_alarms / max(float(row["first_matches"]), 1) * float(row["first_spread"]), 1e-9)
    mirror = float(row.get("log10_false_alarms_mirrored", 0))
    together = DECADES_TOGETHER.get(row["feature"], DECADES_TOGETHER_LEARNED)
    strength = max(float(row["guided_inliers"]) - false_alarms, 1e-9)
    of_place = 1 / (1 + (together / decades) ** 6) / (1 + (OF_ONE_THING / strength) ** 6)
    return of_place / (1 + 10.0 ** np.clip(false_alarms - mirror, -300, 300))


def is_right(row):
    distance_m, angle_deg = float(row["distance_m"]), float(row["angle_deg"])
    return distance_m <= RIGHT_M[row["place"]] and angle_deg <= RIGHT_DEG


def focal_contradicted(row):
    log_scale = abs(np.log(float(row["focal_scale"])))
    surely = log_scale > FOCAL_SIGMAS * float(row["focal_log_sigma"])
    decades = float(row.get("focal_decades", 99))
    return (log_scale > FOCAL_LOG and surely and decades > FOCAL_DECADES) or (log_scale > FAR_LOG and decades > FAR_DECADES)


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
    rows = []
    for name in sys.argv[1:]:
        with open(name, encoding="utf-8") as table:
            rows += [row for row in csv.DictReader(table) if row["first_matches"]]
    terms = np.array([evidence(row) for row in rows])
    right = np.array([is_right(row) for row in rows], float)
    place = np.array([row["place"] for row in rows])
    kind = np.array([row["kind"] for row in rows])
    feature = np.array([row["feature"] for row in rows])
    alarms = 10.0 ** np.minimum([float(row["log10_false_alarms"]) for row in rows], 9)
    rival = np.array([float(row["rival_inliers"]) / max(float(row["first_inliers"]), 1) for row in rows])
    twin = np.array([float(row["twin_inliers"]) / max(float(row["guided_inliers"]), 1) for row in rows])
    alike = np.array([against_likeness(row) for row in rows])
    contradicted = np.array([focal_contradicted(row) for row in rows])
    in_fit = ~np.isin(kind, WRONG_CAMERA)
    for fitted_on in ("office", "kitchen", None):
        used = in_fit & (place == fitted_on) if fitted_on else in_fit
        weights = fit(terms[used], right[used])
        probability = 1 / (1 + np.exp(-terms @ weights)) / (1 + alarms) * alike / (1 + rival**6) / (1 + (twin / TWIN_SHARE) ** 6)
        accepted = (probability >= ACCEPTED) & ~contradicted
        print(f"fitted on {fitted_on or 'all'} ({used.sum()} queries): {weights.round(3)}")
        for one in dict.fromkeys(feature):
            judged = (feature == one) & ((place != fitted_on) if fitted_on else True)

            def count(mask, wanted):
                return f"{(judged & mask & wanted).sum()} of {(judged & mask).sum()}"

            wrong = in_fit & (right == 0)
            print(
                f"  {one}, judged on {'the other places' if fitted_on else 'all'}: accepted: {count(wrong, accepted)} wrong, "
                f"{count(np.isin(kind, FOREIGN), accepted)} foreign, {count(np.isin(kind, WRONG_CAMERA), accepted)} with another "
                f"focal length; missed: {count(np.isin(kind, OWN_VIEWS) & (right == 1), ~accepted)} own views that are right, "
                f"{count(np.isin(kind, THINNED) & (right == 1), ~accepted)} thinned"
            )


if __name__ == "__main__":
    main()
