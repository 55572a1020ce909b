"""A reader that knows nothing of CarRL decodes every topic: mcap-protobuf-support alone, in a process of its own."""

import json
import subprocess
import sys

from carrl.log import read_columns, read_episodes, read_metrics
from tests.logs import make_schema

PROGRAM = """
import json, sys
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

found = {}
with open(sys.argv[1], "rb") as file:
    for schema, channel, message, decoded in make_reader(
        file, validate_crcs=True, decoder_factories=[DecoderFactory()]
    ).iter_decoded_messages():
        values = {}
        for field in decoded.DESCRIPTOR.fields:
            value = getattr(decoded, field.name)
            values[field.name] = value if isinstance(value, (int, float, str, bool)) else list(value)
        found.setdefault(channel.topic, []).append([schema.name, message.log_time, values])
assert not any(name.split(".")[0] == "carrl" for name in sys.modules)
print(json.dumps(found))
"""


def test_a_generic_protobuf_reader_decodes_the_same_numbers(log_path):
    finished = subprocess.run([sys.executable, "-c", PROGRAM, str(log_path)], capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    found = json.loads(finished.stdout)
    assert sorted(found) == ["/episodes", "/metrics", "/transitions"]

    batches = [values for _, _, values in found["/transitions"]]
    assert {name for name, _, _ in found["/transitions"]} == {"carrl.Transitions"}
    assert [(batch["offset"], batch["count"]) for batch in batches] == [(0, 4), (4, 1), (5, 4)]
    columns = read_columns(log_path)
    for column in make_schema().columns:
        decoded = [value for batch in batches for value in batch[column.name]]
        assert decoded == columns[column.name].flatten().tolist(), column.name

    for topic, messages in (("/episodes", read_episodes(log_path)), ("/metrics", read_metrics(log_path))):
        for (_, _, values), message in zip(found[topic], messages, strict=True):
            assert {type(value) for value in values.values()} <= {int, float, str, list}
            fields = message.row() if topic == "/metrics" else message._asdict()
            for name, expected in fields.items():
                assert values[name] == (list(expected) if isinstance(expected, tuple) else expected)
    runs = {values["run"] for messages in found.values() for _, _, values in messages}
    assert len(runs) == 1
