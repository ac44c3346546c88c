"""Reads killed recordings as a stream, and the recovered ones by their index; checks that the second hold what the first do."""

import sys
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

files = messages = 0
for name in sys.argv[1:]:
    torn = {}
    with open(name, "rb") as stream:
        try:
            for _, channel, message in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                torn[channel.topic] = torn.get(channel.topic, 0) + 1
        except (McapError, EOFError):
            pass  # its end is missing
    whole = {}
    with open(Path(name).with_suffix(".whole.mcap"), "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for _, channel, message in reader.iter_messages():
            whole[channel.topic] = whole.get(channel.topic, 0) + 1
        counts = reader.get_summary().statistics.channel_message_counts
        assert sum(counts.values()) == sum(whole.values()), (name, counts, whole)
    assert torn and whole, (name, torn, whole)
    for topic, count in torn.items():
        assert whole.get(topic, 0) >= count, (name, topic, count, whole)
    files += 1
    messages += sum(whole.values())
print(f"mcap read {files} files, {messages} messages")
