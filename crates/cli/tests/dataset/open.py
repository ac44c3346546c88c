"""Opens exports of a sequence with programs of others, where this Python has them, and prints what they find, a line each.

Usage: open.py FOLDER, with the exports euroc, kapture-again, model and lamar in it. Of PyPI: evo, kapture, pycolmap, PyYAML.
"""

import importlib.util
import pathlib
import sys

root = pathlib.Path(sys.argv[1])


def has(name):
    return importlib.util.find_spec(name) is not None


if has("evo"):
    from evo.tools import file_interface

    truth = root / "euroc/mav0/state_groundtruth_estimate0/data.csv"
    print("evo euroc", file_interface.read_euroc_csv_trajectory(str(truth)).num_poses)
    print("evo tum", file_interface.read_tum_trajectory_file(str(root / "euroc/truth.tum")).num_poses)
if has("kapture"):
    from kapture.io.csv import kapture_from_dir

    data = kapture_from_dir(str(root / "kapture-again"))
    images = [image for _, images in data.records_camera.items() for image in images.items()]
    print("kapture images", len(images))
    print("kapture poses", sum(len(poses) for _, poses in data.trajectories.items()))
    print("kapture cameras", len(data.sensors))
if has("pycolmap"):
    import pycolmap

    model = pycolmap.Reconstruction(root / "model/sparse")
    print("pycolmap images", model.num_images())
    print("pycolmap cameras", model.num_cameras())
if has("yaml"):
    import yaml

    text = (root / "euroc/mav0/cam0/sensor.yaml").read_text()
    sensor = yaml.safe_load(text)
    print("yaml transform", len(sensor["T_BS"]["data"]))
    print("yaml intrinsics", len(sensor["intrinsics"]))
