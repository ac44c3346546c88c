"""Counts the records of recordings that others made, without lsfb: what an import must find.

Usage: python3 counts.py FOLDER > counts.txt, where FOLDER holds the recordings (LSFB_TEST_DATA). Needs nothing but Python.
Each line: file or folder below FOLDER, kind of record as the import calls it, how many there are.
"""

import collections
import gzip
import pathlib
import struct
import sys

root = pathlib.Path(sys.argv[1])


def lines(path):
    opened = gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else open(path, encoding="utf-8")
    with opened as file:
        return [line for line in file if line.strip() and not line.startswith("#")]


def say(source, kind, count):
    print(f"{source}\t{kind}\t{count}")


walks = "vision/indoorloc20/site1/F1/path_data_files"
for path in sorted((root / walks).glob("*.txt.gz")):
    kinds = collections.Counter(line.rstrip("\n").split("\t")[1] for line in lines(path))
    for kind, count in sorted(kinds.items()):
        say(f"{walks}/{path.name}", kind, count)

tumvi = "vision/tumvi_calib_imu1"
for sensor in ("cam0", "cam1", "imu0", "mocap0"):
    say(tumvi, f"{sensor}/data.csv", len(lines(root / tumvi / "mav0" / sensor / "data.csv")))

iphone = "vision/ios_logger_iphone"
for path in sorted((root / iphone).glob("*.txt.gz")):
    say(iphone, path.name.removesuffix(".gz"), len(lines(path)))

m1x = "vision/kapture_samples/m1x"
for name in ("camera", "lidar", "wifi", "bluetooth"):
    say(m1x, f"records_{name}.txt", len(lines(root / m1x / "sensors" / f"records_{name}.txt")))

# VRS: a head of 32 bytes before each record; type 3 is what a sensor measured, streams 1 and 2 are the file's own.
for name in ("recording.vrs", "aria_gen2_unit_test_sequence_with_bluetooth.vrs"):
    data = (root / "vision/aria" / name).read_bytes()
    at = struct.unpack_from("<Q", data, 40)[0]
    kinds = collections.Counter()
    while at < len(data):
        size, _, stream, _, _, instance, kind, _, _ = struct.unpack_from("<IIiIdHBBI", data, at)
        if kind == 3 and stream > 2:
            kinds[f"{stream}-{instance}"] += 1
        at += size
    for kind, count in sorted(kinds.items()):
        say(f"vision/aria/{name}", kind, count)
