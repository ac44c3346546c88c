"""The PyPI `mcap` writer on the bytes that `mcap_write` left in a folder; figures as there."""

import sys
import time
from pathlib import Path

from mcap.writer import CompressionType, Writer

folder = Path(sys.argv[1])
runs = int(sys.argv[2]) if len(sys.argv) > 2 else 3
IMAGE, PACKET, IMAGES, PACKETS = 1 << 20, 1206, 200, 22_600
data = (folder / "images.bin").read_bytes()
images = [data[i : i + IMAGE] for i in range(0, len(data), IMAGE)]
data = (folder / "packets.bin").read_bytes()
packets = [data[i : i + PACKET] for i in range(0, len(data), PACKET)]
per_image = PACKETS // IMAGES


def write(path, compression):
    wall, cpu = time.perf_counter(), time.process_time()
    with open(path, "wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=4 << 20)
        writer.start()
        schema = writer.register_schema("x/msg/X", "ros2msg", b"uint8[] data")
        image = writer.register_channel("/image", "cdr", schema)
        velodyne = writer.register_channel("/velodyne", "cdr", schema)
        for n in range(IMAGES):
            at = n * 50_000_000
            writer.add_message(image, log_time=at, publish_time=at, data=images[n % len(images)])
            for packet in packets[n * per_image : (n + 1) * per_image]:
                writer.add_message(velodyne, log_time=at, publish_time=at, data=packet)
        writer.finish()
    return time.process_time() - cpu, time.perf_counter() - wall


for name, compression in [
    ("none", CompressionType.NONE),
    ("lz4", CompressionType.LZ4),
    ("zstd", CompressionType.ZSTD),
]:
    path = folder / "py.mcap"
    cpu, wall = sorted(write(path, compression) for _ in range(runs))[runs // 2]
    size = (IMAGES * IMAGE + PACKETS * PACKET) / 1e6
    print(f"{name}: PyPI mcap {size / cpu:.0f} MB/s of CPU ({wall:.2f} s wall, {path.stat().st_size / 1e6:.0f} MB)")
path.unlink()
