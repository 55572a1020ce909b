"""What a log's readers give, and that whatever is no intact log comes out as one LogError."""

import os
import random
import zlib

import numpy as np
import pytest
import torch
import zstandard
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, Writer

from carrl.errors import DamagedLogError, LogError
from carrl.log import (
    Log,
    Selection,
    fill,
    load,
    read_attachment,
    read_columns,
    read_episodes,
    read_metadata,
    read_metrics,
    read_summary,
)
from carrl.log.codec import Batch
from carrl.log.log_file import describe, with_checksum
from carrl.log.mcap_records import unpack
from carrl.log.mcap_write import McapFile
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import MESSAGE_NAMES, METADATA_NAME, TRANSITIONS, schema_bytes
from carrl.log.verification import verify
from carrl.log.writer import LogWriter
from tests.logs import make_schema

ALL_READERS = (read_columns, read_summary, lambda path: read_attachment(path, "no such name"))


def assert_refused(path, words, readers=ALL_READERS):
    for read in readers:
        with pytest.raises(LogError) as caught:
            read(path)
        assert words in str(caught.value)
        assert str(caught.value).startswith(f"log '{path}': ")
        assert "\n" not in str(caught.value)


def write_mcap(path, *, metadata=None, topic=TRANSITIONS, schema=MESSAGE_NAMES[TRANSITIONS], messages=(), **options):
    """A file as another program might write it."""
    with open(path, "wb") as file:
        writer = Writer(file, **options)
        writer.start()
        if metadata != {}:
            writer.add_metadata(METADATA_NAME, metadata or describe(1, 0, {}, {}))
        schema_id = writer.register_schema(schema, "protobuf", schema_bytes(TRANSITIONS, make_schema()))
        channel_id = writer.register_channel(topic, "protobuf", schema_id, {"columns": make_schema().as_json()})
        for message in messages:
            writer.add_message(channel_id, 0, message, 0)
        writer.finish()
    return path


@pytest.fixture
def long_log(tmp_path, transitions):
    """A log of 12,000 transitions in several chunks, of 2,400 episodes of five steps, and what was written."""
    path = tmp_path / "long.mcap"
    written = []
    with LogWriter(path, schema=make_schema(), attachments={}, metadata={}) as writer:
        for part in range(12):
            batch = transitions(1000, seed=part)
            batch["episode"] += part * 200
            begins = batch["time_ns"][::5].tolist()
            for number, begin in enumerate(begins, start=part * 200):
                writer.write_episode(
                    Episode(number, 0, 0, 0, begin, begin + 500_000_000, 0.0, 5, 0, 0, "collision", (0.0, 0.0, 0.0))
                )
            writer.write(batch)
            writer.flush()
            written.append(batch)
    return path, torch.cat(written)


def test_a_summary_counts_what_was_written(log_path):
    summary = read_summary(log_path)
    assert (summary.format_version, summary.transitions, summary.episodes_ended) == (3, 9, 2)
    assert summary.messages == {"/transitions": 3, "/episodes": 2, "/metrics": 1}
    assert (summary.start_time_s, summary.end_time_s, summary.time_span_s) == (0.0, 0.8, 0.8)
    assert summary.attachments == {"config.yaml": 8, "track.json": 16}
    assert summary.metadata["track"] == "oval"
    assert summary.schema == make_schema()
    assert summary.file_bytes == log_path.stat().st_size == pytest.approx(summary.bytes_per_transition * 9)


def test_columns_have_their_loaded_types(log_path):
    columns = read_columns(log_path)
    assert columns["action"].dtype == np.int64
    assert columns["observation"].dtype == np.float32
    assert columns["terminated"].dtype == np.bool_
    assert {values.shape[0] for values in columns.values()} == {9}


def test_episodes_and_metrics_come_back_as_they_were_written(log_path):
    assert read_episodes(log_path) == [
        Episode(0, 2, 0, 5, 0, 500_000_000, -149.5, 5, 1, 0, "collision", (1.0, -2.5, 0.75)),
        Episode(1, 0, 1, 9, 500_000_000, 900_000_000, 400.0, 4, 8, 1, "time limit", (0.5, 0.0, -3.0)),
    ]
    assert read_metrics(log_path) == [
        Metrics(9, 3, 0.25, 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99})
    ]


def test_an_attachment_is_read_back(log_path):
    assert read_attachment(log_path, "track.json") == b'{"name": "oval"}'


def test_an_attachment_that_is_not_there_is_answered_with_those_that_are(log_path):
    with pytest.raises(LogError, match=r"has no attachment 'x\.txt'; it has: 'config\.yaml', 'track\.json'"):
        read_attachment(log_path, "x.txt")


@pytest.mark.parametrize(
    "selection",
    [
        Selection(episodes=[0]),
        Selection(episodes=[1234, 1235, 2399]),
        Selection(episodes={700}, envs=[2]),
        Selection(envs=[1, 2]),
        Selection(begin_s=300.0, end_s=300.5),
        Selection(begin_s=1199.9),
        Selection(end_s=0.1),
        Selection(episodes=[5, 600], begin_s=300.2, end_s=1e9),
        Selection(episodes=[99_999]),
        Selection(begin_s=-5.0, end_s=0.0),
    ],
)
def test_a_selection_gives_what_filtering_everything_gives(long_log, selection):
    path, written = long_log
    times, wanted = written["time_ns"], torch.ones(len(written), dtype=torch.bool)
    if selection.episodes is not None:
        wanted &= torch.isin(written["episode"], torch.tensor(list(selection.episodes)))
    if selection.envs is not None:
        wanted &= torch.isin(written["car"], torch.tensor(list(selection.envs)))
    if selection.begin_s is not None:
        wanted &= times >= round(selection.begin_s * 1e9)
    if selection.end_s is not None:
        wanted &= times < round(selection.end_s * 1e9)
    columns = read_columns(path, selection)
    assert columns["time_ns"].tolist() == times[wanted].tolist()
    assert np.array_equal(columns["state"].reshape(-1, 3), written["pose"][wanted].numpy())


def test_an_episode_is_read_from_the_chunks_that_hold_it_alone(long_log, monkeypatch):
    unpacked = []
    monkeypatch.setattr("carrl.log.mcap_read.unpack", lambda chunk: unpacked.append(chunk) or unpack(chunk))
    with Log(long_log[0]) as log:
        list(log.episodes())
        listed = len(unpacked)
        log.columns(Selection(episodes=[1234]))
    assert listed == 12
    assert len(unpacked) == listed + 12 + 1  # the list of episodes again, and one chunk of transitions


def test_an_episode_that_never_ended_is_found_all_the_same(tmp_path, transitions):
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        writer.write(transitions(23))
    assert read_columns(tmp_path / "a.mcap", Selection(episodes=[4]))["step"].tolist() == [0, 1, 2]


def test_loading_takes_the_same_selection(long_log):
    loaded = load(long_log[0], episodes=[7, 8], begin_s=3.7)
    assert loaded["episode"].tolist() == [7] * 3 + [8] * 5


def test_filling_a_buffer_gives_it_every_transition_in_order(long_log):
    from torchrl.data import LazyTensorStorage, ReplayBuffer

    path, written = long_log
    buffer = ReplayBuffer(storage=LazyTensorStorage(30_000), batch_size=32)
    assert fill(buffer, [path, path]) == 24_000
    assert torch.equal(buffer[:]["next", "reward"], torch.cat([written, written])["next", "reward"])
    assert buffer.sample()["next", "done"].dtype == torch.bool
    assert fill(buffer, path, Selection(episodes=[3])) == 5


def test_places_that_hold_no_file_are_refused(tmp_path):
    assert_refused(tmp_path / "missing.mcap", "cannot be read: No such file or directory")
    assert_refused(tmp_path / "a\0.mcap", "embedded null")
    assert_refused(tmp_path, "is a folder; give a file, such as")
    os.mkfifo(tmp_path / "pipe")
    assert_refused(tmp_path / "pipe", "is not a regular file")


def test_files_that_are_no_mcap_are_refused(tmp_path):
    for name, content, words in (
        ("empty", b"", "is empty, 0 bytes"),
        ("text", b"hello, I am a text file", "is not an MCAP file, it starts with b'hello, I'"),
        ("short", b"\n", "is not an MCAP file"),
        ("magic", MCAP0_MAGIC, "is unfinished, 8 bytes"),
        ("magics", MCAP0_MAGIC * 2, "is unfinished, 16 bytes"),
        ("zeros", MCAP0_MAGIC + bytes(100) + MCAP0_MAGIC, "is damaged: its last record is no footer"),
    ):
        (tmp_path / name).write_bytes(content)
        assert_refused(tmp_path / name, words)


def test_a_log_that_is_being_written_is_read_as_far_as_it_has_come(tmp_path, transitions):
    path = tmp_path / "train.mcap"
    with LogWriter(path, schema=make_schema(), attachments={"config.yaml": b"seed: 1"}, metadata={}) as writer:
        assert len(read_columns(path)["step"]) == 0
        writer.write(transitions(4))
        writer.flush()
        with open(path, "ab") as file:  # a record of which half is there yet
            file.write(path.read_bytes()[-20:])
        assert len(read_columns(path)["step"]) == 4
        assert read_attachment(path, "config.yaml") == b"seed: 1"
        with pytest.raises(DamagedLogError, match="is unfinished"):
            verify(path)
        os.truncate(path, path.stat().st_size - 20)
        writer.write(transitions(2))
        writer.write_episode(Episode(0, 0, 0, 4, 0, 400_000_000, 1.0, 4, 0, 0, "collision", (0.0, 0.0, 0.0)))
        writer.flush()
        assert len(read_columns(path)["step"]) == 6
        assert [episode.length for episode in read_episodes(path)] == [4]
        assert read_summary(path).transitions == 6
    verify(path)


def test_what_nobody_writes_any_more_is_unfinished(tmp_path, transitions):
    path = tmp_path / "train.mcap"
    with LogWriter(path, schema=make_schema(), attachments={}, metadata={}) as writer:
        writer.write(transitions(4))
        writer.flush()
        killed = path.read_bytes()
    path.write_bytes(killed)
    assert_refused(path, "is unfinished")


def test_every_sampled_truncation_is_refused(log_path):
    whole = log_path.read_bytes()
    for size in [*range(1, len(whole), 29), *range(len(whole) - 45, len(whole))]:
        log_path.write_bytes(whole[:size])
        assert_refused(log_path, "is unfinished")


def test_whatever_byte_is_flipped_a_reader_gives_the_original_or_refuses(log_path):
    whole = log_path.read_bytes()
    readers = (lambda path: read_attachment(path, "track.json"), read_metadata, read_episodes, read_metrics, _all_bytes)
    originals = [read(log_path) for read in readers]
    draw = random.Random(7)
    refused = 0
    for _ in range(400):
        damaged = bytearray(whole)
        damaged[draw.randrange(len(whole))] ^= draw.randrange(1, 256)
        log_path.write_bytes(damaged)
        for read, original in zip(readers, originals, strict=True):
            try:
                assert read(log_path) == original
            except LogError:
                refused += 1
    assert refused > 400


def _all_bytes(path):
    return [values.tobytes() for values in read_columns(path).values()]


def test_bytes_after_the_end_or_in_the_middle_are_refused(log_path):
    whole = log_path.read_bytes()
    log_path.write_bytes(whole + whole)
    assert_refused(log_path, "damaged")
    log_path.write_bytes(whole[:500] + bytes(20) + whole[500:])
    assert_refused(log_path, "damaged")


def test_an_mcap_of_another_program_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    assert_refused(write_mcap(path, topic="/lidar"), "no topic /transitions among: none")
    assert_refused(write_mcap(path, metadata={}), "no metadata record 'carrl'")
    assert_refused(write_mcap(path, schema="other.Message"), "has the schema ('protobuf', 'protobuf', 'other.Message')")


@pytest.mark.parametrize("version", ["1", "4"])
def test_an_unknown_format_version_is_refused(tmp_path, version):
    entries = with_checksum({**describe(1, 0, {}, {}), "format_version": version})
    assert_refused(
        write_mcap(tmp_path / "a.mcap", metadata=entries), f"has format version '{version}', this carrl reads 2 and 3;"
    )


def test_metadata_that_somebody_changed_is_refused(tmp_path):
    entries = {**describe(1, 0, {"seed": "1"}, {}), "seed": "2"}
    assert_refused(write_mcap(tmp_path / "a.mcap", metadata=entries), "its metadata does not have the checksum")


def test_a_log_rewritten_without_crcs_is_read(tmp_path, transitions):
    batch = transitions(5)
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        writer.write(batch)
    message = Batch(make_schema(), 1, 0, read_columns(tmp_path / "a.mcap")).encode()
    path = write_mcap(tmp_path / "b.mcap", messages=[message], enable_crcs=False)
    assert torch.equal(load(path)["pose"], batch["pose"])


def test_a_message_that_lies_about_its_length_is_refused_without_allocating(tmp_path):
    for claim in (1, 2**32 - 1):
        message = make_schema().message_class(count=claim, observation=bytes(400)).SerializeToString()
        path = write_mcap(tmp_path / "a.mcap", messages=[message])
        assert_refused(path, "message 0 is wrong: column 'observation' has 400 bytes", [read_columns, read_summary])


def test_messages_that_are_no_transitions_are_refused(tmp_path, log_path):
    wire = make_schema().message_class
    first = {name: values[:1] for name, values in read_columns(log_path).items()}
    one_transition = wire.FromString(Batch(make_schema(), 1, 0, first).encode())
    one_transition.exploratory = b"\x02"
    for message, words in (
        (b"\xff\xff\xff", "not a carrl.Transitions message"),
        (wire(count=0, action=bytes(4)).SerializeToString(), "a batch of no transitions"),
        (b"", "a batch of no transitions"),
        (one_transition.SerializeToString(), "'exploratory' holds a byte that is neither 0 nor 1"),
    ):
        assert_refused(write_mcap(tmp_path / "a.mcap", messages=[message]), words, [read_columns, read_summary])


@pytest.mark.parametrize("claimed", [10, 2**40])
def test_a_chunk_that_would_unpack_to_gigabytes_is_refused(claimed):
    content = bytes(2**27)
    with pytest.raises(ValueError, match="a chunk claims"):
        unpack(Chunk("zstd", zstandard.compress(content), 0, 0, zlib.crc32(content), claimed))


def test_an_index_that_names_one_chunk_many_times_is_refused(tmp_path, log_path, monkeypatch):
    finish = McapFile.finish

    def with_every_chunk_twice(file):
        file._index.chunks *= 2
        finish(file)

    monkeypatch.setattr(McapFile, "finish", with_every_chunk_twice)
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        writer.write_metrics(Metrics(0, 0, 0.0, 0.0, {"td_error": 0.0, "action_value": 0.0, "epsilon": 0.0}))
    with pytest.raises(DamagedLogError, match="its index tells of chunks that overlap"):
        read_summary(tmp_path / "a.mcap")
