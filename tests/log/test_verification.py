"""What verification says of an intact log, and that no kind of damage passes it."""

import random
import re
import zlib

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Message, Metadata
from mcap.writer import MCAP0_MAGIC

from benchmarks.log_faults.sample import read_sample
from carrl.errors import DamagedLogError, LogError
from carrl.log import IntactLog, read_columns, verification, verify
from carrl.log.codec import Batch
from carrl.log.log_file import begin_log, describe, with_checksum
from carrl.log.mcap_read import IndexedFile
from carrl.log.schema import CHANNELS, METADATA_NAME, TRANSITIONS
from tests.logs import make_schema

SCHEMA = make_schema()


def record_bytes(record):
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def flipped(content, place):
    return content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :]


def assert_damaged(path, content, words="damaged|is unfinished|is not a|has format version"):
    path.write_bytes(content)
    with pytest.raises(DamagedLogError, match=words) as caught:
        verify(path)
    assert str(caught.value).startswith(f"log '{path}': ")
    assert "\n" not in str(caught.value)


def write_batches(path, batches, *, run=1, metadata=None, attachments=None):
    """A finished log of these batches, as a program with errors might write it."""
    file = begin_log(path, metadata or describe(run, 0, {}, {}), attachments or {}, make_schema())
    for number, batch in enumerate(batches):
        file.add_chunk([Message(CHANNELS[TRANSITIONS], number, batch.encode(), number, number)])
    file.finish()
    file.close()
    return path


@pytest.fixture
def columns(log_path):
    return read_columns(log_path)


def test_an_intact_log_is_told_by_what_it_holds(log_path):
    assert verify(log_path) == IntactLog(transitions=9, episodes=2, metrics=1)


def test_an_empty_log_is_intact(tmp_path):
    assert verify(write_batches(tmp_path / "a.mcap", [])) == IntactLog(0, 0, 0)


def test_every_flipped_byte_is_noticed(log_path):
    whole = log_path.read_bytes()
    draw = random.Random(5)
    for place in sorted(draw.sample(range(len(whole)), 400)):
        assert_damaged(log_path, flipped(whole, place))


def test_every_cut_is_noticed(log_path):
    whole = log_path.read_bytes()
    for size in [*range(0, len(whole), 97), *range(len(whole) - 9, len(whole))]:
        assert_damaged(log_path, whole[:size], "is empty|is unfinished|is not an MCAP file")


@pytest.mark.parametrize("kind", ["metadata", "attachment", "chunk"])
def test_a_record_that_is_missing_doubled_or_elsewhere_is_noticed(log_path, kind):
    whole = log_path.read_bytes()
    for piece in read_sample(log_path).pieces:
        if piece.kind == kind:
            end = piece.begin + len(piece.content)
            assert_damaged(log_path, whole[: piece.begin] + whole[end:])
            assert_damaged(log_path, whole[:end] + piece.content + whole[end:])
            assert_damaged(log_path, whole[: piece.begin] + whole[end:] + piece.content)


def test_bytes_after_the_end_and_records_after_the_data_are_noticed(log_path):
    whole = log_path.read_bytes()
    assert_damaged(log_path, whole + MCAP0_MAGIC, "8 bytes after the last record")
    end = whole.index(bytes([Opcode.DATA_END]) + (4).to_bytes(8, "little"))
    assert_damaged(log_path, whole[:end] + record_bytes(Metadata("x", {})) + whole[end:])


def test_a_data_section_that_does_not_end_is_noticed(log_path):
    whole = log_path.read_bytes()
    crc = zlib.crc32(whole[: (end := whole.index(bytes([Opcode.DATA_END]) + (4).to_bytes(8, "little")))])
    data_end = record_bytes(DataEnd(crc))
    assert whole[end : end + len(data_end)] == data_end
    other = bytes([0x7F]) + data_end[1:]
    assert_damaged(log_path, whole.replace(data_end, other), "the summary has CRC")


def test_an_intact_record_that_the_index_does_not_tell_of_is_noticed(log_path, monkeypatch):
    walk = verification._walk
    for kind in (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA):
        monkeypatch.setattr(verification, "_walk", lambda path, kind=kind: {**walk(path), kind: [8]})
        with pytest.raises(DamagedLogError, match=f"its index does not tell where its {kind.name.lower()} records are"):
            verify(log_path)


def test_transitions_missing_between_two_batches_are_noticed(tmp_path, columns):
    path = write_batches(tmp_path / "a.mcap", [Batch(SCHEMA, 1, 0, columns), Batch(SCHEMA, 1, 10, columns)])
    with pytest.raises(DamagedLogError, match="9 transitions are followed by number 10"):
        verify(path)


def test_messages_of_another_run_are_noticed(tmp_path, columns):
    path = write_batches(tmp_path / "a.mcap", [Batch(SCHEMA, 1, 0, columns), Batch(SCHEMA, 2, 9, columns)])
    with pytest.raises(DamagedLogError, match="it is of another run than the metadata"):
        verify(path)
    with pytest.raises(DamagedLogError, match="it is of another run than the metadata"):
        read_columns(path)


def test_another_number_of_rays_is_noticed(tmp_path, columns):
    wide = columns | {name: np.tile(columns[name], 2) for name in ("observation", "next_observation")}
    path = write_batches(tmp_path / "a.mcap", [Batch(make_schema(), 1, 0, columns), Batch(make_schema(14), 1, 9, wide)])
    with pytest.raises(DamagedLogError, match="message 1 is wrong: column 'observation' has"):
        verify(path)


def test_metadata_of_another_run_are_noticed_by_every_reader(tmp_path, columns):
    path = write_batches(tmp_path / "a.mcap", [Batch(make_schema(), 1, 0, columns)])
    other = write_batches(tmp_path / "b.mcap", [], run=2).read_bytes()
    first = record_bytes(Metadata(METADATA_NAME, describe(1, 0, {}, {})))
    second = record_bytes(Metadata(METADATA_NAME, describe(2, 0, {}, {})))
    assert second in other
    path.write_bytes(path.read_bytes().replace(first, second))
    for read in (verify, read_columns):
        with pytest.raises(DamagedLogError, match=r"its metadata is that of another run|the data section has CRC"):
            read(path)


def test_an_attachment_that_the_metadata_do_not_tell_of_is_noticed(tmp_path):
    entries = describe(1, 0, {}, {"config.yaml": b"seed: 1\n"})
    path = write_batches(tmp_path / "a.mcap", [], metadata=entries, attachments={"config.yaml": b"seed: 2\n"})
    with pytest.raises(
        DamagedLogError, match=r"its attachment 'config\.yaml' is not the one that its metadata tells of"
    ):
        verify(path)


def test_changed_metadata_are_noticed(tmp_path):
    entries = {**describe(1, 0, {"seed": "1"}, {}), "seed": "2"}
    path = write_batches(tmp_path / "a.mcap", [], metadata=entries)
    with pytest.raises(DamagedLogError, match="its metadata does not have the checksum"):
        verify(path)
    assert verify(write_batches(path, [], metadata=with_checksum(entries))).transitions == 0


def test_a_chunk_whose_head_is_zeroed_is_noticed_by_every_reader(log_path):
    """Read by itself, it would be an empty chunk without compression and without a CRC."""
    with IndexedFile(log_path) as file:
        begin = file.index.chunks[0].chunk_start_offset
    whole = log_path.read_bytes()
    head = begin + 1 + 8
    for read in (verify, read_columns):
        log_path.write_bytes(whole[:head] + bytes(60) + whole[head + 60 :])
        with pytest.raises(DamagedLogError):
            read(log_path)


@pytest.mark.parametrize(
    ("name", "words", "error"),
    [
        ("missing.mcap", "cannot be read: No such file or directory", LogError),
        ("folder", "is a folder", LogError),
        ("empty.mcap", "is empty, 0 bytes", DamagedLogError),
        ("text.mcap", "is not an MCAP file, it starts with b'I am a t'", DamagedLogError),
        ("magic.mcap", "is unfinished, 8 bytes without the mark", DamagedLogError),
    ],
)
def test_what_is_no_log_is_refused(tmp_path, name, words, error):
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("I am a text file.")
    (tmp_path / "magic.mcap").write_bytes(MCAP0_MAGIC)
    with pytest.raises(error, match=re.escape(words)) as caught:
        verify(tmp_path / name)
    assert isinstance(caught.value, DamagedLogError) == (error is DamagedLogError)


def test_refusals_of_damage_tell_the_remedy(log_path):
    log_path.write_bytes(flipped(log_path.read_bytes(), 4000))
    with pytest.raises(DamagedLogError, match="salvage it with: carrl log recover IN OUT"):
        verify(log_path)
