"""PyPI velodyne-decoder on the same capture: its fastest of three ways, best of several passes, CPU time, one thread.

usage: peer.py FILE.pcap [PASSES]
"""

import sys
import time

import velodyne_decoder as vd


def packets(path):
    """UDP payloads of a pcap of Ethernet frames without tags and options, with their stamps."""
    data = open(path, "rb").read()
    at, out = 24, []
    while at < len(data):
        secs, nanos, length = (int.from_bytes(data[at + i : at + i + 4], "little") for i in (0, 4, 8))
        out.append((secs + nanos * 1e-9, data[at + 16 + 42 : at + 16 + length]))
        at += 16 + length
    return out


def config():
    return vd.Config(model=vd.Model.VLP32C)


def one_by_one(stream):
    decoder, points = vd.StreamDecoder(config()), 0
    for stamp, payload in stream:
        scan = decoder.decode(stamp, payload, False)
        points += 0 if scan is None else len(scan[1])
    scan = decoder.finish(False)
    return points + (0 if scan is None else len(scan[1]))


def in_bulk(revolutions):
    """One call per revolution: no Python between packets."""
    decoder = vd.ScanDecoder(config())
    return sum(len(decoder.decode(revolution)[1]) for revolution in revolutions)


def from_file(path):
    return sum(len(points) for _, points in vd.read_pcap(path, config()))


def best(passes, work):
    points, cpu = 0, float("inf")
    for _ in range(passes):
        before = time.process_time()
        points = work()
        cpu = min(cpu, time.process_time() - before)
    return points, cpu


def main():
    path, passes = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5
    stream = packets(path)
    per_revolution = 76  # half a turn is dark
    revolutions = []
    for first in range(0, len(stream), per_revolution):
        vector = vd.PacketVector()
        for stamp, payload in stream[first : first + per_revolution]:
            vector.append(vd.VelodynePacket(stamp, payload))
        revolutions.append(vector)
    for what, work in (
        ("memory, packet by packet", lambda: one_by_one(stream)),
        ("memory, in bulk", lambda: in_bulk(revolutions)),
        ("pcap", lambda: from_file(path)),
    ):
        try:
            points, cpu = best(passes, work)
        except Exception as error:  # a way that this version or file does not have
            print(f"peer from {what}: {error}")
            continue
        print(
            f"peer from {what}: {len(stream)} packets, {points} points, cpu {cpu:.4f} s: "
            f"{points / cpu / 1e6:.1f} Mpoint/s, {len(stream) / cpu:.0f} packets/s"
        )


main()
