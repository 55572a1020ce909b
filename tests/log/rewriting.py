"""Logs as other programs write them anew: `mcap`'s own writer, and every option that it has."""

import heapq
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from carrl.log.schema import EPISODES, METRICS, TRANSITIONS

BACKWARDS = (METRICS, EPISODES, TRANSITIONS)
NOTHING_TOLD = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}

VARIANTS = {
    "channels in another order": {"topics": BACKWARDS},
    "no chunks": {"use_chunking": False},
    "no chunks, no summary": {"use_chunking": False, **NOTHING_TOLD},
    "no chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "no message index": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no attachment index": {"index_types": IndexType.ALL & ~IndexType.ATTACHMENT},
    "no metadata index": {"index_types": IndexType.ALL & ~IndexType.METADATA},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "no channels and schemas in the summary": {"repeat_channels": False, "repeat_schemas": False},
    "no summary": NOTHING_TOLD,
    "LZ4": {"compression": CompressionType.LZ4},
    "LZ4, no summary": {"compression": CompressionType.LZ4, **NOTHING_TOLD},
    "not packed": {"compression": CompressionType.NONE},
    "no CRCs": {"enable_crcs": False},
    "small chunks": {"chunk_size": 300},
    "sequences all 0": {"sequence": 0},
}
"""What a program may do differently, and how `rewrite` is told to."""


def rewrite(source: Path, target: Path, *others: Path, topics=(TRANSITIONS, EPISODES, METRICS), **options) -> Path:
    """Writes a log anew, or several merged by time into one file.

    Args:
        source: a log.
        target: the new file.
        others: further logs, that are merged into it.
        topics: in which order their channels are made; one named twice has two, used by turns.
        options: of the writer; also `sequence`, for every message in place of its own, `backwards`, and `without`,
            topics whose messages, and names of attachments that, are left out.
    """
    sequence, backwards = options.pop("sequence", None), options.pop("backwards", False)
    without = options.pop("without", ())
    with target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(library="another program")
        streams = [_copied(path, writer, topics, without) for path in (source, *others)]
        merged = list(heapq.merge(*streams, key=lambda entry: entry[0]))
        for _, _, channel, message in reversed(merged) if backwards else merged:
            number = message.sequence if sequence is None else sequence
            writer.add_message(channel, message.log_time, message.data, message.publish_time, number)
        writer.finish()
    return target


def _copied(path: Path, writer: Writer, topics, without) -> list[tuple]:
    """Copies what is not a message, and returns the messages in their order: time, place, channel, message."""
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for attachment in (each for each in reader.iter_attachments() if each.name not in without):
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
            )
        by_topic = {channel.topic: channel for channel in summary.channels.values()}
        numbers = {topic: [] for topic in topics}
        for topic in topics:
            schema = summary.schemas[by_topic[topic].schema_id]
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[topic].append(writer.register_channel(topic, "protobuf", schema_id, by_topic[topic].metadata))
        return [
            (message.log_time, place, numbers[channel.topic][place % len(numbers[channel.topic])], message)
            for place, (_, channel, message) in enumerate(reader.iter_messages(log_time_order=False))
            if channel.topic in topics and channel.topic not in without
        ]
