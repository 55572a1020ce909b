"""Logs that another program wrote anew, as MCAP allows: each is read, checked and recovered as the original is."""

import zlib
from dataclasses import replace

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, CompressionType

from carrl.errors import DamagedLogError, LogError
from carrl.log import (
    Log,
    Selection,
    read_attachment,
    read_columns,
    read_episodes,
    read_metadata,
    read_metrics,
    read_summary,
    recover,
    verify,
)
from carrl.log.mcap_read import IndexedFile
from carrl.log.mcap_write import serialise
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import CHANNELS, EPISODES, METRICS, TRANSITIONS
from carrl.log.writer import LogWriter
from tests.log.rewriting import BACKWARDS, NOTHING_TOLD, VARIANTS, rewrite
from tests.logs import make_schema


def assert_same(path, original):
    columns, expected = read_columns(path), read_columns(original)
    for name, values in expected.items():
        assert columns[name].tobytes() == values.tobytes(), name
    assert read_episodes(path) == read_episodes(original)
    assert read_metrics(path) == read_metrics(original)
    for name in ("config.yaml", "track.json"):
        assert read_attachment(path, name) == read_attachment(original, name)
    assert read_metadata(path) == read_metadata(original)
    assert verify(path) == verify(original)
    found, wanted = read_summary(path), read_summary(original)
    assert (found.messages, found.attachments) == (wanted.messages, wanted.attachments)
    assert (found.transitions, found.start_time_s, found.end_time_s) == (9, wanted.start_time_s, wanted.end_time_s)


@pytest.fixture
def second_log(tmp_path, transitions):
    """A log of another run: three transitions, and its own metadata and attachments."""
    path = tmp_path / "second.mcap"
    attachments = {"config.yaml": b"seed: 2\n", "track.json": b'{"name": "ring"}'}
    with LogWriter(path, schema=make_schema(), attachments=attachments, metadata={"track": "ring"}) as writer:
        writer.write(transitions(3, seed=9))
        writer.write_episode(Episode(0, 0, 0, 3, 0, 300_000_000, 1.0, 3, 0, 0, "collision", (0.0, 0.0, 0.0)))
        writer.write_metrics(Metrics(3, 1, 0.5, 500.0, {"td_error": 0.5, "action_value": 0.5, "epsilon": 0.5}))
    return path


@pytest.mark.parametrize("variant", VARIANTS)
def test_whatever_mcap_lets_a_writer_leave_out_a_log_is_read_whole(log_path, tmp_path, variant):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", **VARIANTS[variant])
    assert_same(path, log_path)


@pytest.mark.parametrize("variant", VARIANTS)
def test_whatever_mcap_lets_a_writer_leave_out_a_log_is_recovered_whole(log_path, tmp_path, variant):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", **VARIANTS[variant])
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert recovery.complete
    assert (recovery.transitions, recovery.episodes, recovery.metrics) == (9, 2, 1)
    assert recovery.unchecked == (6 if variant in ("no CRCs", "no chunks", "no chunks, no summary") else 0)
    assert_same(tmp_path / "recovered.mcap", log_path)


def test_messages_outside_of_chunks_are_verified_where_the_whole_file_has_a_checksum(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", use_chunking=False, enable_data_crcs=True)
    content = path.read_bytes()
    assert recover(path, tmp_path / "recovered.mcap").unchecked == 0
    place = content.index(b"/episodes") - 100
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    with pytest.raises(DamagedLogError, match="the data section has CRC"):
        read_episodes(path)


@pytest.mark.parametrize(
    "options",
    [{"chunk_size": 1}, {"chunk_size": 3000}, {"chunk_size": 1, **NOTHING_TOLD}, {"use_chunking": False}],
    ids=["a message a chunk", "mixed chunks", "no summary", "no chunks"],
)
def test_an_episode_is_selected_as_from_the_original(tmp_path, transitions, options):
    with LogWriter(tmp_path / "original.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        for part in range(12):
            batch = transitions(10, seed=part)
            batch["episode"] += 2 * part
            writer.write(batch)
            for episode, begin in ((2 * part, part), (2 * part + 1, part + 0.5)):
                begin_ns = int(begin * 1e9)
                writer.write_episode(
                    Episode(episode, 0, 0, 0, begin_ns, begin_ns + 500_000_000, 0.0, 5, 0, 0, "collision", (0.0,) * 3)
                )
            writer.flush()
    path = rewrite(tmp_path / "original.mcap", tmp_path / "rewritten.mcap", **options)
    for episode in range(24):
        columns = read_columns(path, Selection(episodes=[episode]))
        assert columns["step"].tolist() == [0, 1, 2, 3, 4]
        assert np.array_equal(
            columns["state"], read_columns(tmp_path / "original.mcap", Selection(episodes=[episode]))["state"]
        )
    assert len(read_columns(path, Selection(begin_s=2.2, end_s=7.7))["step"]) == 55


def test_a_log_whose_index_is_whole_is_not_read_from_begin_to_end(log_path, monkeypatch):
    monkeypatch.setattr("carrl.log.mcap_read.scan", lambda *_: pytest.fail("the whole file was read"))
    assert read_summary(log_path).transitions == 9


def test_a_message_beside_the_chunks_is_not_overlooked(log_path, tmp_path):
    """An index may tell of every chunk, and the statistics count every message, and yet one lies in no chunk."""
    whole = rewrite(log_path, tmp_path / "whole.mcap", use_chunking=False)
    with IndexedFile(whole) as file:
        stretch = file.index.chunks[0]
    lone = whole.read_bytes()[stretch.chunk_start_offset :][: stretch.chunk_length]
    chunked = rewrite(log_path, tmp_path / "chunked.mcap")
    content = chunked.read_bytes()
    with IndexedFile(chunked) as file:
        end = file.index.chunks[-1].chunk_start_offset
    chunked.write_bytes(content[:end] + lone + content[end:])
    with pytest.raises(LogError):
        read_columns(chunked)


def test_another_compression_is_not_supported_and_not_called_damaged(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", enable_crcs=False)
    path.write_bytes(path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0brot"))
    with pytest.raises(LogError, match=r"is not supported: a chunk is packed with 'brot'; zstd, lz4 or") as caught:
        read_columns(path)
    assert not isinstance(caught.value, DamagedLogError)
    assert "recover" not in str(caught.value)


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_damaged_chunk_is_damaged_however_it_is_packed(log_path, tmp_path, compression):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", compression=compression)
    with IndexedFile(path) as file:
        place = file.index.chunks[0].chunk_start_offset + file.index.chunks[0].chunk_length // 2
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(DamagedLogError, match="salvage it with: carrl log recover IN OUT"):
        read_columns(path)


def test_two_logs_merged_into_one_file_are_told_apart_and_each_is_recovered(log_path, second_log, tmp_path):
    path = rewrite(log_path, tmp_path / "merged.mcap", second_log)
    with pytest.raises(
        LogError, match=r"holds 2 logs merged into one file.* carrl log recover IN OUT --run RUN"
    ) as caught:
        Log(path)
    assert not isinstance(caught.value, DamagedLogError)
    for original in (log_path, second_log):
        run, target = read_metadata(original)["run"], tmp_path / f"recovered-{original.name}"
        assert run in str(caught.value)
        recovery = recover(path, target, run)
        assert len(recovery.runs_left_out) == 1
        assert not recovery.complete
        assert recovery.messages_lost == 0
        assert read_columns(target)["reward"].tolist() == read_columns(original)["reward"].tolist()
        assert read_episodes(target) == read_episodes(original)
        assert read_attachment(target, "config.yaml") == read_attachment(original, "config.yaml")


def test_a_run_that_the_file_does_not_hold_is_answered_with_those_that_it_does(log_path, tmp_path):
    run = read_metadata(log_path)["run"]
    with pytest.raises(LogError, match=f"holds nothing of run 'x'; it has: '{run}'"):
        recover(log_path, tmp_path / "new.mcap", "x")
    assert not (tmp_path / "new.mcap").exists()


def test_a_log_merged_with_itself_loses_nothing(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "merged.mcap", log_path)
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.messages_lost, recovery.duplicates_left_out, recovery.complete) == (0, 6, True)
    assert read_columns(tmp_path / "recovered.mcap")["reward"].tolist() == read_columns(log_path)["reward"].tolist()
    assert read_episodes(tmp_path / "recovered.mcap") == read_episodes(log_path)


def test_a_duplicate_in_the_place_of_a_message_does_not_hide_its_loss(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", chunk_size=1, compression=CompressionType.NONE)
    with IndexedFile(path) as file:
        first, *_, last = [chunk for chunk in file.index.chunks if 1 in chunk.message_index_offsets]
    content, begin = path.read_bytes(), last.chunk_start_offset
    message = content[: first.chunk_start_offset + first.chunk_length][
        2 - last.uncompressed_size :
    ]  # offset 0 has no field
    copy = Chunk("", message, first.message_end_time, first.message_start_time, zlib.crc32(message), len(message))
    path.write_bytes(content[:begin] + serialise(copy) + bytes(2) + content[begin + last.chunk_length :])
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.transitions, recovery.messages_lost, recovery.duplicates_left_out) == (5, 1, 1)
    assert not recovery.complete


def test_two_parts_of_a_run_merged_into_one_file_are_no_damage_and_what_recovery_leaves_out_is_told(
    tmp_path, transitions
):
    attachments = {"config.yaml": b"", "track.json": b""}
    with LogWriter(
        tmp_path / "a.mcap", None, 1, 2**20, schema=make_schema(), attachments=attachments, metadata={}
    ) as writer:
        while writer.path == tmp_path / "a.mcap":
            writer.write(transitions(4000))
    path = rewrite(tmp_path / "a.mcap", tmp_path / "merged.mcap", tmp_path / "a-1.mcap")
    with pytest.raises(LogError, match="holds 2 parts of one run merged into one file") as caught:
        Log(path)
    assert not isinstance(caught.value, DamagedLogError)
    recovery = recover(path, tmp_path / "new.mcap")
    assert recovery.transitions + recovery.transitions_left_out == sum(
        verify(tmp_path / name).transitions for name in ("a.mcap", "a-1.mcap")
    )
    assert not recovery.complete


def test_recovery_asks_the_channel_records_though_the_file_is_cut_off(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", topics=BACKWARDS, chunk_size=2000)
    with IndexedFile(path) as file:
        last = file.index.chunks[-1]
    path.write_bytes(path.read_bytes()[: last.chunk_start_offset + last.chunk_length])
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.transitions, recovery.episodes, recovery.metrics, recovery.finished) == (9, 2, 1, False)
    assert_same(tmp_path / "recovered.mcap", log_path)


def test_recovery_invents_nothing_where_no_channel_record_is_left(log_path, tmp_path):
    """Of a chunk alone, whose messages of one topic have the number that another topic has in a log of CarRL's."""
    content = RecordBuilder()
    with log_path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages():
            replace(message, channel_id=4 - message.channel_id).write(content)
    messages = bytes(content.end())
    path = tmp_path / "chunk.mcap"
    path.write_bytes(MCAP0_MAGIC + serialise(Chunk("", messages, 900_000_000, 0, zlib.crc32(messages), len(messages))))
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.transitions, recovery.episodes, recovery.metrics) == (0, 2, 0)
    assert read_episodes(tmp_path / "recovered.mcap") == read_episodes(log_path)


def test_recovery_tells_of_messages_that_the_statistics_count_and_that_are_not_found(log_path, tmp_path, monkeypatch):
    from carrl.log import mcap_write

    count = mcap_write._statistics

    def with_more(index):
        statistics = count(index)
        statistics.channel_message_counts[3] += 5
        statistics.message_count += 5
        return statistics

    monkeypatch.setattr(mcap_write, "_statistics", with_more)
    recover(log_path, tmp_path / "boasting.mcap")
    monkeypatch.undo()
    recovery = recover(tmp_path / "boasting.mcap", tmp_path / "new.mcap")
    assert (recovery.finished, recovery.messages_lost, recovery.complete) == (True, 5, False)


def test_what_is_no_part_of_a_log_is_named_when_recovery_leaves_it_out(log_path, tmp_path, monkeypatch):
    from mcap.writer import Writer

    finish = Writer.finish

    def with_more(writer):
        writer.add_metadata("notes", {"a": "b"})
        writer.add_attachment(0, 0, "notes.txt", "text/plain", b"nice")
        writer.add_message(writer.register_channel("/notes", "json", 0), 0, b"{}", 0)
        finish(writer)

    monkeypatch.setattr(Writer, "finish", with_more)
    path = rewrite(log_path, tmp_path / "rewritten.mcap")
    assert verify(path) == verify(log_path)
    assert read_attachment(path, "notes.txt") == b"nice"
    recovery = recover(path, tmp_path / "new.mcap")
    assert recovery.others_left_out == ("topic '/notes'", "metadata 'notes'", "attachment 'notes.txt'")
    assert not recovery.complete


def test_an_unfinished_file_without_chunks_is_not_said_to_have_been_empty(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", use_chunking=False)
    path.write_bytes(path.read_bytes()[:-10])
    recovery = recover(path, tmp_path / "new.mcap")
    assert recovery.transitions == 0
    assert recovery.others_left_out == ("6 messages outside of chunks, for which no checksum vouches",)


def test_topics_are_those_of_the_channel_records(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", topics=BACKWARDS)
    with IndexedFile(path) as file:
        assert [file.index.channels[number].topic for number in (1, 3)] == [METRICS, TRANSITIONS]
    assert np.array_equal(read_columns(path)["state"], read_columns(log_path)["state"])


@pytest.mark.parametrize("lost", CHANNELS)
def test_a_topic_that_another_program_left_out_is_named(log_path, tmp_path, lost):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", topics=[topic for topic in CHANNELS if topic != lost])
    with pytest.raises(DamagedLogError, match=f"is damaged: it has no topic {lost}, which every log has; salvage"):
        verify(path)
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.topics_lost, recovery.complete) == ((lost,), False)
    assert recovery.episode_steps == (0 if lost == EPISODES else 9)
    verify(tmp_path / "recovered.mcap")  # of which it is known


def test_episodes_without_a_transition_are_not_called_intact(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", without=(TRANSITIONS,))
    with pytest.raises(DamagedLogError, match="its ended episodes have 9 steps, but it has no transitions"):
        verify(path)
    recovery = recover(path, tmp_path / "recovered.mcap")
    assert (recovery.topics_lost, recovery.episode_steps, recovery.complete) == ((TRANSITIONS,), 9, False)
    verify(tmp_path / "recovered.mcap")


def test_attachments_that_another_program_left_out_are_named(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", without=("track.json",))
    with pytest.raises(
        DamagedLogError, match=r"it lacks the attachments that its metadata tells of: 'track.json'; salv"
    ):
        verify(path)
    recovered = tmp_path / "recovered.mcap"
    assert recover(path, recovered).attachments_lost == ("track.json",)
    assert verify(recovered) == verify(log_path)
    again = rewrite(recovered, tmp_path / "again.mcap", without=("config.yaml",))
    with pytest.raises(DamagedLogError, match=r"its metadata tells of: 'config.yaml'; salvage"):
        verify(again)


def test_two_channels_of_one_topic_count_as_one(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", topics=BACKWARDS + BACKWARDS)
    with IndexedFile(path) as file:
        assert [channel.topic for channel in file.index.channels.values()] == list(BACKWARDS + BACKWARDS)
        assert len([number for number in file.index.messages if file.index.messages[number]]) > len(BACKWARDS)
    assert_same(path, log_path)


def test_messages_that_a_chunk_has_backwards_are_recovered_in_their_order(log_path, tmp_path):
    path = rewrite(log_path, tmp_path / "rewritten.mcap", backwards=True)
    with pytest.raises(DamagedLogError, match="0 transitions are followed by number"):
        verify(path)
    assert recover(path, tmp_path / "recovered.mcap").complete
    columns, expected = read_columns(tmp_path / "recovered.mcap"), read_columns(log_path)
    assert all(columns[name].tobytes() == expected[name].tobytes() for name in expected)
