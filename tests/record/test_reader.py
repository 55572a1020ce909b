"""What a summary says, and that whatever is no intact log comes out as one LogError."""

import contextlib
import os
import random
import zlib

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from carrl.errors import LogError
from carrl.log import read_attachment, read_columns, read_summary
from carrl.record.codec import encode
from carrl.record.container import intact_records
from carrl.record.schema import MESSAGE_NAME, METADATA_NAME, TOPIC, schema_bytes, wire_class

ALL_READERS = (read_columns, read_summary, lambda path: read_attachment(path, "no such name"))


def assert_refused(path, words, readers=ALL_READERS):
    for read in readers:
        with pytest.raises(LogError) as caught:
            read(path)
        assert words in str(caught.value)
        assert str(caught.value).startswith(f"log '{path}': ")
        assert "\n" not in str(caught.value)


def write_mcap(path, *, version="1", topic=TOPIC, schema=MESSAGE_NAME, messages=(), **options):
    """A file as another program might write it."""
    with open(path, "wb") as file:
        writer = Writer(file, **options)
        writer.start()
        if version is not None:
            writer.add_metadata(METADATA_NAME, {"format_version": version})
        schema_id = writer.register_schema(schema, "protobuf", schema_bytes())
        channel_id = writer.register_channel(topic, "protobuf", schema_id)
        for message in messages:
            writer.add_message(channel_id, 0, message, 0)
        writer.finish()
    return path


def test_a_summary_counts_what_was_written(log_path):
    summary = read_summary(log_path)
    columns = read_columns(log_path)
    assert (summary.format_version, summary.messages, summary.transitions) == (1, 3, 9)
    assert summary.episodes_ended == (columns["terminated"] | columns["truncated"]).sum() > 0
    assert (summary.start_time_s, summary.end_time_s, summary.time_span_s) == (0.0, 0.2, 0.2)
    assert summary.attachments == {"config.yaml": 8, "track.json": 16}
    assert summary.metadata["track"] == "oval"
    assert summary.metadata["column.pose"].startswith("float32 [3], x m, y m, heading rad")
    assert summary.row_shapes["observation"] == (7,)
    assert summary.row_shapes["action"] == ()
    assert summary.file_bytes == log_path.stat().st_size == pytest.approx(summary.bytes_per_transition * 9)


def test_columns_have_their_loaded_types(log_path):
    columns = read_columns(log_path)
    assert columns["action"].dtype == np.int64
    assert columns["observation"].dtype == np.float32
    assert columns["terminated"].dtype == np.bool_
    assert {values.shape[0] for values in columns.values()} == {9}


def test_an_attachment_is_read_back(log_path):
    assert read_attachment(log_path, "track.json") == b'{"name": "oval"}'


def test_an_attachment_that_is_not_there_is_answered_with_those_that_are(log_path):
    with pytest.raises(LogError, match=r"has no attachment 'x\.txt'; it has: 'config\.yaml', 'track\.json'"):
        read_attachment(log_path, "x.txt")


def test_places_that_hold_no_file_are_refused(tmp_path):
    assert_refused(tmp_path / "missing.mcap", "cannot be read: No such file or directory")
    assert_refused(tmp_path / "a\0.mcap", "cannot be read: embedded null byte")
    assert_refused(tmp_path, "is a folder; give a file, such as")
    os.mkfifo(tmp_path / "pipe")
    assert_refused(tmp_path / "pipe", "is not a regular file")


def test_files_that_are_no_mcap_are_refused(tmp_path):
    for name, content, words in (
        ("empty", b"", "is empty, 0 bytes"),
        ("text", b"hello, I am a text file", "is not an MCAP file, it starts with b'hello, I'"),
        ("short", b"\n", "is not an MCAP file"),
        ("magic", MCAP0_MAGIC, "is unfinished, 8 bytes"),
        ("magics", MCAP0_MAGIC * 2, "damaged"),
    ):
        (tmp_path / name).write_bytes(content)
        assert_refused(tmp_path / name, words)


def test_every_sampled_truncation_is_refused(log_path):
    whole = log_path.read_bytes()
    for size in [*range(1, len(whole), 13), *range(len(whole) - 45, len(whole))]:
        log_path.write_bytes(whole[:size])
        assert_refused(log_path, "is unfinished")


def test_every_flipped_byte_is_noticed(log_path):
    whole = log_path.read_bytes()
    draw = random.Random(7)
    for _ in range(200):
        damaged = bytearray(whole)
        damaged[draw.randrange(len(whole))] ^= draw.randrange(1, 256)
        log_path.write_bytes(damaged)
        assert_refused(log_path, "log")


def test_an_attachment_read_early_from_a_damaged_file_is_the_original_or_refused(log_path):
    whole = log_path.read_bytes()
    draw = random.Random(8)
    for _ in range(100):
        damaged = bytearray(whole)
        damaged[draw.randrange(len(whole))] ^= draw.randrange(1, 256)
        log_path.write_bytes(damaged)
        with contextlib.suppress(LogError):
            assert read_attachment(log_path, "track.json") == b'{"name": "oval"}'


def test_bytes_after_the_end_or_in_the_middle_are_refused(log_path):
    whole = log_path.read_bytes()
    log_path.write_bytes(whole + whole)
    assert_refused(log_path, "damaged")
    log_path.write_bytes(whole[:500] + bytes(20) + whole[500:])
    assert_refused(log_path, "damaged")


def test_an_mcap_of_another_program_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    assert_refused(write_mcap(path, version=None, topic="/lidar"), "no topic /transitions among: '/lidar'")
    assert_refused(write_mcap(path, version=None), "no metadata record 'carrl'")
    assert_refused(write_mcap(path, schema="other.Message"), "has the schema ('protobuf', 'protobuf', 'other.Message')")


def test_an_unknown_format_version_is_refused(tmp_path):
    assert_refused(write_mcap(tmp_path / "a.mcap", version="2"), "has format version '2', this carrl reads 1")


def test_a_log_rewritten_without_crcs_or_chunks_is_read(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", enable_crcs=False, use_chunking=False)
    assert read_summary(path).transitions == 0


def test_a_message_that_lies_about_its_length_is_refused_without_allocating(tmp_path):
    for claim in (1, 2**32 - 1):
        message = wire_class()(count=claim, action=bytes(400)).SerializeToString()
        path = write_mcap(tmp_path / "a.mcap", messages=[message])
        assert_refused(path, "message 0 is wrong: column 'action' has 400 bytes", [read_columns, read_summary])


def test_messages_that_are_no_transitions_are_refused(tmp_path, log_path):
    wire = wire_class()
    one_transition = wire.FromString(encode({name: values[:1] for name, values in read_columns(log_path).items()}))
    one_transition.exploratory = b"\x02"
    for message, words in (
        (b"\xff\xff\xff", "not a carrl.Transitions message"),
        (wire(count=0, action=bytes(4)).SerializeToString(), "'action' has 4 bytes, which do not fit 0 transitions"),
        (one_transition.SerializeToString(), "'exploratory' holds a byte that is neither 0 nor 1"),
    ):
        assert_refused(write_mcap(tmp_path / "a.mcap", messages=[message]), words, [read_columns, read_summary])


def test_an_unreadable_compression_is_named(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", messages=[b""], compression=CompressionType.LZ4)
    assert_refused(path, "a chunk is packed with 'lz4'; only zstd or nothing can be read")


@pytest.mark.parametrize("claimed", [10, 2**40])
def test_a_chunk_that_would_unpack_to_gigabytes_is_refused(tmp_path, claimed):
    content = zstandard.compress(bytes(2**27))
    chunk = Chunk("zstd", content, 0, 0, zlib.crc32(bytes(2**27)), claimed)
    builder = RecordBuilder()
    chunk.write(builder)
    (tmp_path / "a.mcap").write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    with pytest.raises(LogError, match="a chunk claims"):
        list(intact_records(tmp_path / "a.mcap"))
