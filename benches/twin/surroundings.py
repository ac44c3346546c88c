"""What a phone of the twin measured around it, read by foreign programs and held against the truth.

Usage: surroundings.py FOLDER [mcap|rosbags]. FOLDER is that of `lsfb sim --record`. Needs: mcap lz4 zstandard rosbags numpy.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# Its topics are /sidecar/DEVICE/REST.
PREFIX = "/sidecar/"


def types_of(schemas):
    """A type store that knows nothing but what the recording itself says."""
    store = get_typestore(Stores.EMPTY)
    for name, text in schemas:
        types = get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
    return store


def by_mcap(path):
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        store = types_of([(s.name, s.data.decode()) for s in summary.schemas.values()])
        for schema, channel, message in reader.iter_messages():
            if channel.topic.startswith(PREFIX) and not channel.topic.endswith("/image"):
                yield channel.topic[len(PREFIX):].partition("/")[2], store.deserialize_cdr(message.data, schema.name), message.log_time


def by_rosbags(path):
    bag = McapReader(path)
    bag.open()
    store = types_of([(s.name, s.data) for s in bag.schemas.values()])
    wanted = [c for c in bag.connections if c.topic.startswith(PREFIX) and not c.topic.endswith("/image")]
    for connection, log_time, data in bag.messages(wanted):
        yield connection.topic[len(PREFIX):].partition("/")[2], store.deserialize_cdr(data, connection.msgtype), log_time
    bag.close()


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Truth:
    def __init__(self, folder):
        poses = [line.split() for line in open(folder / "truth_walk.tum") if not line.startswith("#")]
        seconds = [p[0].split(".") for p in poses]
        self.times = np.array([int(s) * 10**9 + int(f.ljust(9, "0")) for s, f in seconds])
        self.poses = np.array([[float(v) for v in p[1:]] for p in poses])
        self.around = json.load(open(folder / "truth_surroundings.json"))

    def at(self, time_ns):
        k = min(int(np.searchsorted(self.times, time_ns)), len(self.times) - 1)
        return self.poses[k]

    def rotation(self, time_ns):
        x, y, z, w = self.at(time_ns)[3:]
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])


def ecef(latitude, longitude, height):
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    s, c = math.sin(latitude), math.cos(latitude)
    n = a / math.sqrt(1 - e2 * s * s)
    return np.array([(n + height) * c * math.cos(longitude), (n + height) * c * math.sin(longitude), (n * (1 - e2) + height) * s])


def enu(datum, latitude, longitude, height):
    phi, lam = math.radians(datum["latitude_deg"]), math.radians(datum["longitude_deg"])
    away = ecef(math.radians(latitude), math.radians(longitude), height) - ecef(phi, lam, datum["altitude_m"])
    s, c, sl, cl = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    return np.array([[-sl, cl, 0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]]) @ away


def slope(name, readings, transmitters, truth):
    sources = {t["address"]: t for t in transmitters}
    x, y = [], []
    for address, rssi, time_ns in readings:
        source = sources[address]
        distance = np.linalg.norm(np.array(source["position_m"]) - truth.at(time_ns)[:3])
        first_db = 20 * math.log10(4 * math.pi * source["frequency_mhz"] / 299.792458)
        x.append(10 * math.log10(max(distance, 0.3)))
        y.append(source["power_dbm"] - rssi - first_db)
    x, y = np.array(x), np.array(y)
    design = np.stack([x, np.ones_like(x)], 1)
    (n, offset), *_ = np.linalg.lstsq(design, y, rcond=None)
    rest = y - design @ [n, offset]
    sigma = math.sqrt(rest.var() / max(x.var() * len(x), 1e-9))
    print(f"{name}: {len(x)} readings, exponent {n:.2f} ± {sigma:.2f} (walls included), rest {rest.std():.1f} dB")


def main(folder, reader):
    truth = Truth(folder / "truth")
    datum = truth.around["datum"]
    seen = {}
    for topic, message, log_time in reader(folder / "walk.mcap"):
        seen.setdefault(topic, []).append((message, log_time))
    print("topics:", ", ".join(f"{t} {len(m)}" for t, m in sorted(seen.items())))

    wifi = seen.get("wifi", [])
    scans = sorted({m.scan: t for m, t in wifi}.values())
    if len(scans) > 1:
        print("scans arrive at", [round(float(t - truth.times[0]) * 1e-9, 1) for t in scans], "s")
        slope("wifi", [(m.bssid, m.rssi_dbm, stamp(m)) for m, _ in wifi], truth.around["networks"], truth)
    ble = seen.get("ble", [])
    if ble:
        slope("ble", [(m.address, m.rssi_dbm, stamp(m)) for m, _ in ble], truth.around["beacons"], truth)

    hard, soft = np.array(truth.around["hard_iron_t"]), np.array(truth.around["soft_iron"])
    earth = np.array(truth.around["earth_field_t"])
    fields = []
    for m, _ in seen.get("mag", []):
        raw = np.array([m.magnetic_field.x, m.magnetic_field.y, m.magnetic_field.z])
        fields.append(truth.rotation(stamp(m)) @ np.linalg.solve(soft, raw - hard))
    if fields:
        norms = 1e6 * np.linalg.norm(fields, axis=1)
        apart = 1e6 * np.linalg.norm(np.array(fields) - earth, axis=1)
        print(f"mag: {norms.mean():.1f} ± {norms.std():.1f} µT, Earth's {1e6 * np.linalg.norm(earth):.1f}, bent by {np.median(apart):.1f} (median)")

    errors, nees = [], []
    for m, _ in seen.get("gnss", []):
        if m.status.status < 0:
            continue
        error = enu(datum, m.latitude, m.longitude, m.altitude) - truth.at(stamp(m))[:3]
        errors.append(error)
        nees.append(error @ np.linalg.solve(np.array(m.position_covariance).reshape(3, 3), error))
    if errors:
        rms = np.sqrt((np.array(errors) ** 2).mean(0))
        inside = (np.array(nees) < 7.815).mean()
        print(f"gnss: {len(errors)} of {len(seen['gnss'])} with a fix, rms {rms.round(2)} m east, north, up, in the 95 % region {100 * inside:.0f} %")
    pressure = seen.get("pressure", [])
    if pressure:
        z = np.array([truth.at(stamp(m))[2] for m, _ in pressure])
        p = np.array([m.fluid_pressure for m, _ in pressure])
        if np.ptp(z) > 1:
            print(f"pressure: {np.polyfit(z, p, 1)[0]:.2f} Pa/m")


if __name__ == "__main__":
    main(Path(sys.argv[1]), by_rosbags if sys.argv[2:] == ["rosbags"] else by_mcap)
