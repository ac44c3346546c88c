"""Reads the recording that tests/foreign.rs writes with PyPI `mcap`, `mcap-ros2-support` and `rosbags`, and compares
every value and which intrinsics belong to which image.

Usage: check.py RECORDING. Needs: mcap lz4 zstandard rosbags mcap-ros2-support.
"""

import hashlib
import struct
import sys

from mcap.reader import SeekingReader, NonSeekingReader
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_772_359_200_123_456_789


def stamp_of(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def check(topic, n, message, publish_time, log_time):
    """One message: its number on the topic tells what must be in it."""
    time = START + n * 100_000_000
    if topic == "/tf_static":
        frames = [(t.header.frame_id, t.child_frame_id) for t in message.transforms]
        assert frames == [("rig", "cam0"), ("rig", "lidar"), ("rig", "imu0")], frames
        rotation = message.transforms[0].transform.rotation
        assert abs(rotation.z - 0.24740395925452294) < 1e-15 and abs(rotation.w - 0.9689124217106447) < 1e-15
        return
    if topic == "/rerun/tf_static":
        assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [("tf#/", "odom")]
        return
    if topic == "/tf":
        (edge,) = message.transforms
        assert (edge.header.frame_id, edge.child_frame_id) == ("odom", "rig")
        assert stamp_of(edge.header) == time == publish_time and log_time == time + 3_000_000
        translation, rotation = edge.transform.translation, edge.transform.rotation
        assert (translation.x, translation.y, translation.z) == (n, 0.5, -0.25)
        assert abs(rotation.z - 0.24740395925452294) < 1e-15 and abs(rotation.w - 0.9689124217106447) < 1e-15
        return
    if topic == "/cam0/camera_info":
        assert (message.width, message.height, message.distortion_model) == (6, 4, "plumb_bob")
        assert list(message.k) == [5.0, 0.0, 2.5, 0.0, 5.5, 1.5, 0.0, 0.0, 1.0]
        assert list(message.p)[:8] == [5.0, 0.0, 2.5, 0.0, 0.0, 5.5, 1.5, 0.0] and len(message.d) == 5
        return
    assert stamp_of(message.header) == time == publish_time, (topic, n)
    data = bytes(message.data) if hasattr(message, "data") else b""
    if topic == "/lidar/packets":
        assert log_time == time + 2
        assert [p.stamp.sec * 10**9 + p.stamp.nanosec for p in message.packets] == [time, time + 1, time + 2]
        assert [bytes(p.data) for p in message.packets] == [bytes([i + n]) * 1206 for i in range(3)]
    elif topic == "/lidar/position":
        assert log_time == time + 3
        assert (message.source, message.kind, message.seq) == ("lidar/position", 0, n)
        assert data == bytes([3 + n]) * 512
    else:
        assert log_time == time + 3_000_000
        if topic == "/cam0/image":
            assert (message.width, message.height, message.encoding, message.step) == (6, 4, "mono8", 6)
            assert message.header.frame_id == "cam0" and data == bytes(i * 3 + n for i in range(24))
        elif topic == "/cam0/frame_meta":
            meta = (message.frame_id, message.device_ticks, message.exposure_ns, bytes(message.trailer))
            assert meta == (n, 5_000_000_000 + n, 4_000_000 + n, bytes([0x3B, n]))
        elif topic == "/imu0/data_raw":
            rate, force = message.angular_velocity, message.linear_acceleration
            assert (rate.x, rate.y, rate.z) == (n * 0.25, -1.0, 0.5)
            assert (force.x, force.y, force.z) == (0.125, n, 9.75)
            assert message.orientation_covariance[0] == -1.0
            # The densities of the rig at the rate of the samples, 10 Hz; unknown for the first.
            for covariance, density in (
                (message.angular_velocity_covariance, 1e-3),
                (message.linear_acceleration_covariance, 1e-2),
            ):
                variance = density**2 * 10.0 if n else 0.0
                expected = [variance, 0, 0, 0, variance, 0, 0, 0, variance]
                assert all(abs(a - b) <= 1e-9 * density**2 for a, b in zip(covariance, expected)), covariance
        elif topic in ("/imu0/time_ref", "/lidar/time_ref"):
            assert message.time_ref.sec * 10**9 + message.time_ref.nanosec == 5_000_000_000 + n
        elif topic == "/sidecar/phone/mag":
            field = message.magnetic_field
            assert (field.x, field.y, field.z) == (1e-6 * n, -2e-6, 4.5e-5)
            assert list(message.magnetic_field_covariance) == [1e-14, 0, 0, 0, 2e-14, 0, 0, 0, 3e-14]
        elif topic == "/sidecar/phone/pressure":
            assert (message.fluid_pressure, message.variance) == (95_000.25 + n, 2.25)
        elif topic == "/sidecar/phone/gnss":
            if n % 2:
                assert message.status.status == -1 and message.latitude != message.latitude
                assert message.position_covariance_type == 0
            else:
                assert (message.status.status, message.status.service, message.position_covariance_type) == (0, 1, 3)
                assert (message.latitude, message.longitude, message.altitude) == (48.125, 11.5 + n, 519.5)
                assert list(message.position_covariance) == [4, 0.5, 0.25, 0.5, 9, -1, 0.25, -1, 16]
        elif topic == "/sidecar/phone/wifi":
            heard = (message.scan, message.bssid, message.ssid, message.frequency_mhz, message.rssi_dbm)
            assert heard == (n, "02:00:5e:10:00:01", "lsfb", 5180, -60 - n)
        elif topic == "/sidecar/phone/ble":
            assert (message.address, message.uuid) == ("c0:01:02:03:04:05", "9195b3ad-a9d0-4500-85ff-9fb0f65a5201")
            assert (message.major, message.minor) == (258, n)
            assert (message.measured_power_dbm, message.rssi_dbm, data) == (-56, -84, bytes([2, 1, n]))
        elif topic == "/lidar/points":
            assert [f.name for f in message.fields] == ["x", "y", "z", "intensity", "ring", "return_type", "t"]
            points = [struct.unpack_from("<ffffHxxI", data, i * message.point_step) for i in range(message.width)]
            assert points == [(i + 0.5, n, -0.25, 10.0 * i, i, 55_296 * i) for i in range(3)], points
        else:
            raise AssertionError(f"unexpected topic {topic}")


def types_of(schemas):
    """A type store that knows nothing but what the recording itself says."""
    store = get_typestore(Stores.EMPTY)
    for name, text in schemas:
        types = get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
    return store


def check_pairs(stamps):
    """What an exact time synchronizer (message_filters) does: each image has intrinsics with its own frame and stamp."""
    images, intrinsics = stamps["/cam0/image"], stamps["/cam0/camera_info"]
    assert len(images) == 20 and images == intrinsics, (images[:3], intrinsics[:3])
    # Each cloud can be placed at its very stamp.
    clouds, poses = stamps["/lidar/points"], stamps["/tf"]
    assert [stamp for _, stamp in clouds] == [stamp for _, stamp in poses]


def check_all(reader_name, messages, deserialise):
    counts = {}
    stamps = {}
    for topic, kind, data, publish_time, log_time in messages:
        n = counts.get(topic, 0)
        message = deserialise(data, kind)
        check(topic, n, message, publish_time, log_time)
        counts[topic] = n + 1
        if topic.startswith("/cam0/") or topic in ("/lidar/points", "/tf"):
            header = message.transforms[0].header if topic == "/tf" else message.header
            stamps.setdefault(topic, []).append((header.frame_id, stamp_of(header)))
    check_pairs(stamps)
    expected = {"/tf_static": 1, "/rerun/tf_static": 1}
    for topic, count in counts.items():
        assert count == expected.get(topic, 20), (topic, count)
    print(f"{reader_name}: {sum(counts.values())} messages")


def main(path):
    with open(path, "rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert all(c.message_encoding == "cdr" for c in summary.channels.values())
        assert all(s.encoding == "ros2msg" for s in summary.schemas.values())
        store = types_of([(s.name, s.data.decode()) for s in summary.schemas.values()])
        items = [
            (c.topic, s.name, m.data, m.publish_time, m.log_time)
            for s, c, m in reader.iter_messages(log_time_order=False)
        ]
        check_all("mcap", items, store.deserialize_cdr)
        attachments = list(reader.iter_attachments())
        assert [a.name for a in attachments] == ["rig.toml"]
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert metadata["lsfb.session"]["software"].startswith("lsfb ")
        rig = metadata["lsfb.rig"]
        assert rig["sha256"] == hashlib.sha256(attachments[0].data).hexdigest()
        assert (rig["name"], rig["calibrated_unix_s"]) == ("backpack", "1772350000")
        stream.seek(0)
        linear = NonSeekingReader(stream, validate_crcs=True)
        assert len(list(linear.iter_messages())) == len(items)

    from pathlib import Path

    bag = McapReader(Path(path))
    bag.open()
    schemas = {s.name: s.data for s in bag.schemas.values()}
    store = types_of(schemas.items())
    publish_times = {}
    for topic, _, _, publish_time, _ in items:
        publish_times.setdefault(topic, []).append(publish_time)
    taken = {}

    def messages():
        # rosbags gives the log time only.
        for connection, log_time, data in bag.messages(bag.connections):
            n = taken.get(connection.topic, 0)
            taken[connection.topic] = n + 1
            yield connection.topic, connection.msgtype, data, publish_times[connection.topic][n], log_time

    check_all("rosbags", messages(), store.deserialize_cdr)
    bag.close()

    # As `mcap-ros2-support` decodes it, from the schemas in the file.
    with open(path, "rb") as stream:
        decoded = [
            (m.channel.topic, m.ros_msg, m.publish_time_ns, m.log_time_ns)
            for m in read_ros2_messages(stream, log_time_order=False)
        ]
    check_all(
        "mcap-ros2-support",
        ((topic, None, message, publish, log) for topic, message, publish, log in decoded),
        lambda message, _: message,
    )


if __name__ == "__main__":
    main(sys.argv[1])
