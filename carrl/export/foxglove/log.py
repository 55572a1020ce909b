"""One episode as the content of an MCAP file that viewers draw and plot without being told how.

A message's time is simulated time since the start of the run, as in the run's own log. What a step of that log holds
has the time at which the step begins; poses and rays are also there after the last step. The track and the driven line
come once, at the beginning.
"""

from io import BytesIO

from mcap.writer import CompressionType, Writer

from carrl.export.foxglove.clouds import cloud_entries
from carrl.export.foxglove.entry import Entry
from carrl.export.foxglove.plots import plot_entries
from carrl.export.foxglove.scene import scene_entries
from carrl.log.trace import EpisodeTrace


def log_bytes(trace: EpisodeTrace, title: str) -> bytes:
    """The content of an .mcap file, its messages in the order of their times."""
    entries = [*scene_entries(trace), *cloud_entries(trace), *plot_entries(trace)]
    content = BytesIO()
    writer = Writer(content, compression=CompressionType.ZSTD)
    writer.start(library="carrl")
    writer.add_metadata("episode", _properties(trace, title))
    _write(writer, sorted(entries, key=lambda entry: entry.time_ns))
    writer.finish()
    return content.getvalue()


def _write(writer: Writer, entries: list[Entry]) -> None:
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for entry in entries:
        schema = entry.schema
        if schema.name not in schemas:
            schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if entry.topic not in channels:
            channels[entry.topic] = writer.register_channel(entry.topic, "protobuf", schemas[schema.name])
        writer.add_message(channels[entry.topic], entry.time_ns, entry.content, entry.time_ns)


def _properties(trace: EpisodeTrace, title: str) -> dict[str, str]:
    return {
        "title": title,
        "episode": str(trace.episode),
        "car": str(trace.car),
        "track": trace.track.name,
        "steps": str(len(trace)),
        "episode_return": f"{trace.rewards.sum():g}",
        "gates": str(trace.gates_passed[-1]),
        "ended": trace.ended,
    }
