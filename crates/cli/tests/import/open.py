"""Opens an imported recording with PyPI `mcap` and `rosbags`, decodes every message, and prints how many each topic has.

Usage: open.py RECORDING. Needs: mcap lz4 zstandard rosbags.
"""

import collections
import pathlib
import sys

from mcap.reader import SeekingReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

path = sys.argv[1]
store = get_typestore(Stores.EMPTY)
counts = collections.Counter()
with open(path, "rb") as file:
    for schema, channel, message in SeekingReader(file).iter_messages():
        if schema.name not in store.types:
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
        decoded = store.deserialize_cdr(message.data, schema.name)
        if hasattr(decoded, "header"):
            stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
            assert stamp == message.publish_time, (channel.topic, stamp, message.publish_time)
        counts[channel.topic] += 1
reader = McapReader(pathlib.Path(path))
reader.open()
assert sum(1 for _ in reader.messages(reader.connections)) == sum(counts.values())
for topic, count in sorted(counts.items()):
    print(f"{topic}\t{count}")
