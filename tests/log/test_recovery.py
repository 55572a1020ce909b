"""What is recovered of a damaged log: all that is intact, once, in order, and nothing else."""

import errno
import os
import random
import re
import struct
import zlib
from dataclasses import asdict

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Message
from mcap.writer import MCAP0_MAGIC

from benchmarks.log_faults.contents import places_in, read_contents
from benchmarks.log_faults.sample import read_sample
from carrl.errors import DamagedLogError, LogError
from carrl.log import Recovery, read_columns, recover, verify
from carrl.log.codec import Batch, encode_small
from carrl.log.log_file import begin_log, describe
from carrl.log.mcap_write import McapFile
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import CHANNELS, EPISODES, METRICS, TRANSITIONS
from carrl.log.writer import LogWriter
from tests.logs import make_schema
from tests.operations import count_calls

BATCHES, BATCH = 6, 20


def write_log(path, transitions, *, seed=0, batches=BATCHES, attachments=None):
    """A finished log with a chunk of transitions and one of messages for each batch."""
    attachments = attachments or {"config.yaml": b"seed: %d\n" % seed, "track.json": b'{"name": "oval"}'}
    with LogWriter(path, schema=make_schema(), attachments=attachments, metadata={"seed": str(seed)}) as writer:
        for number in range(batches):
            batch = transitions(BATCH, seed=100 * seed + number)
            end = int(batch["time_ns"][-1])
            writer.write(batch)
            writer.write_episode(
                Episode(number, 0, 0, number, 0, end, -1.5, BATCH, 1, 0, "collision", (1.0, seed, number))
            )
            writer.write_metrics(
                Metrics(number, seed, 0.25, 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99})
            )
            writer.flush()
    return read_sample(path)


@pytest.fixture
def own(tmp_path, transitions):
    return write_log(tmp_path / "own.mcap", transitions, seed=1)


@pytest.fixture
def other(tmp_path, transitions):
    return write_log(tmp_path / "other.mcap", transitions, seed=2)


@pytest.fixture
def recovered(tmp_path):
    """Recovers a file of the bytes given, checks the result and reads it."""

    def recover_bytes(content):
        source, target = tmp_path / "damaged.mcap", tmp_path / "recovered.mcap"
        source.write_bytes(content)
        target.unlink(missing_ok=True)
        recovery = recover(source, target)
        intact, found = verify(target), read_contents(target)
        assert (intact.transitions, intact.episodes, intact.metrics) == (
            recovery.transitions,
            recovery.episodes,
            recovery.metrics,
        )
        assert recovery.transitions == len(found.rows)
        assert source.read_bytes() == content
        return recovery, found

    return recover_bytes


def pieces(sample, kind, topic=None):
    return [piece for piece in sample.pieces if piece.kind == kind and (topic is None or topic in piece.holds)]


def flipped(content, place):
    return content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :]


def beginning(sample):
    """The bytes of a log before its first chunk."""
    return sample.content[: pieces(sample, "chunk")[0].begin]


def chunk_record(content, times=(0, 0), size=None, crc=None, compression="zstd"):
    crc = zlib.crc32(content) if crc is None else crc
    packed = zstandard.compress(content) if compression else content
    builder = RecordBuilder()
    Chunk(compression, packed, times[1], times[0], crc, len(content) if size is None else size).write(builder)
    return bytes(builder.end())


def test_a_finished_log_comes_out_whole(own, recovered):
    recovery, found = recovered(own.content)
    assert found == own.says
    names = ("config.yaml", "track.json")
    assert recovery == Recovery(
        True, BATCHES * BATCH, BATCHES, BATCHES, 0, 0, False, names, (), 0, episode_steps=BATCHES * BATCH
    )
    assert recovery.complete


def test_what_was_recovered_and_lost_is_noted_in_the_new_log(own, tmp_path):
    recovery = recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    records = (tmp_path / "new.mcap").read_bytes()
    assert b"carrl.recovery" in records
    for name in asdict(recovery):
        assert name.encode() in records


def test_recovering_what_was_recovered_changes_nothing(own, tmp_path):
    recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    assert recover(tmp_path / "new.mcap", tmp_path / "newer.mcap").complete
    assert read_contents(tmp_path / "newer.mcap") == own.says


def test_a_log_cut_at_any_byte_gives_every_chunk_before_the_cut(own, recovered):
    ends = [piece.begin + len(piece.content) for piece in own.pieces]
    near_ends = [end + step for end in ends for step in (-1, 0, 1)]
    for size in sorted({*range(1, len(own.content), 401), *near_ends, *range(len(own.content) - 9, len(own.content))}):
        recovery, found = recovered(own.content[:size])
        whole = [piece for piece in own.pieces if piece.begin + len(piece.content) <= size]
        counts = [sum(len(piece.holds.get(topic, ())) for piece in whole) for topic in (TRANSITIONS, EPISODES, METRICS)]
        assert found.rows == own.says.rows[: counts[0]]
        assert found.episodes == own.says.episodes[: counts[1]]
        assert found.metrics == own.says.metrics[: counts[2]]
        assert found.attachments.keys() == {piece.name for piece in whole if piece.kind == "attachment"}
        assert recovery.metadata_lost == (not whole)
        assert not recovery.finished
        assert not recovery.complete


def test_a_flipped_byte_costs_no_more_than_the_record_that_it_is_in(own, recovered):
    draw = random.Random(3)
    for _ in range(60):
        place = draw.randrange(len(own.content))
        _, found = recovered(flipped(own.content, place))
        rows = {
            i for p in own.pieces for i in p.holds.get(TRANSITIONS, ()) if not 0 <= place - p.begin < len(p.content)
        }
        places = places_in(own.says.rows, found.rows)
        assert rows <= set(places)
        assert found.attachments.items() <= own.says.attachments.items()


def test_transitions_missing_in_the_middle_are_counted(own, recovered):
    chunk = pieces(own, "chunk", TRANSITIONS)[2]
    recovery, found = recovered(flipped(own.content, chunk.begin + len(chunk.content) // 2))
    assert found.rows == own.says.rows[: 2 * BATCH] + own.says.rows[3 * BATCH :]
    assert (recovery.transitions_lost, recovery.episodes_lost, recovery.chunks_lost) == (BATCH, 0, 1)
    assert not recovery.complete


def test_the_loss_of_the_last_chunk_of_a_finished_log_does_not_go_unnoticed(own, recovered):
    chunk = pieces(own, "chunk", TRANSITIONS)[-1]
    recovery, found = recovered(flipped(own.content, chunk.begin + len(chunk.content) // 2))
    assert len(found.rows) == (BATCHES - 1) * BATCH
    assert (recovery.finished, recovery.transitions_lost, recovery.chunks_lost) == (True, 0, 1)
    assert not recovery.complete


def test_chunks_doubled_and_out_of_order_come_out_once_and_in_order(own, recovered):
    chunks = 2 * [piece.content for piece in pieces(own, "chunk")]
    for seed in range(5):
        random.Random(seed).shuffle(chunks)
        recovery, found = recovered(beginning(own) + b"".join(chunks))
        assert (found.rows, found.episodes, found.metrics) == (own.says.rows, own.says.episodes, own.says.metrics)
        assert (recovery.transitions_lost, recovery.episodes_lost) == (0, 0)


def test_messages_keep_their_order_where_an_episode_ends_after_the_metrics_that_follow(
    tmp_path, transitions, recovered
):
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        batch = transitions(3)
        end = int(batch["time_ns"][-1])
        writer.write(batch)
        writer.write_metrics(Metrics(1, 0, 0.0, 0.0, {"td_error": 0.0, "action_value": 0.0, "epsilon": 0.0}))
        writer.write_episode(Episode(0, 0, 0, 3, 0, end + 1, 0.0, 3, 0, 0, "collision", (0.0, 0.0, 0.0)))
        writer.flush()
        writer.write_metrics(Metrics(2, 0, 0.0, 0.0, {"td_error": 0.0, "action_value": 0.0, "epsilon": 0.0}))
    _, found = recovered((tmp_path / "a.mcap").read_bytes())
    assert found.metrics == read_contents(tmp_path / "a.mcap").metrics


def test_batches_of_one_and_the_same_time_come_out_in_order(tmp_path, transitions, recovered):
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        for seed in range(4):
            batch = transitions(BATCH, seed=seed)
            writer.write(batch.set("time_ns", batch["time_ns"] * 0))
            writer.flush()
    sample = read_sample(tmp_path / "a.mcap")
    chunks = [piece.content for piece in pieces(sample, "chunk")]
    _, found = recovered(beginning(sample) + b"".join(reversed(chunks)))
    assert found.rows == sample.says.rows


def test_pieces_of_another_run_are_left_out(own, other, recovered):
    chunks = [piece.content for piece in pieces(own, "chunk") + pieces(other, "chunk")[:6]]
    random.Random(0).shuffle(chunks)
    _, found = recovered(beginning(other) + beginning(own) + b"".join(chunks))
    assert found == own.says


def test_messages_of_another_run_in_one_and_the_same_chunk_are_left_out(own, recovered):
    content = RecordBuilder()
    for run in (int(own.says.run, 16), 7):
        message = encode_small(
            METRICS, run, Metrics(9, run % 5, 0.25, 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99})
        )
        Message(CHANNELS[METRICS], 10**12, message, 10**12, sequence=BATCHES + run % 2).write(content)
    _, found = recovered(own.content + chunk_record(bytes(content.end())))
    assert len(found.metrics) == BATCHES + 1


def test_the_run_with_most_transitions_is_recovered_though_pieces_of_the_other_are_there_twice(own, other, recovered):
    chunks = pieces(own, "chunk") + 3 * pieces(other, "chunk")[:6]
    _, found = recovered(beginning(other) + beginning(own) + b"".join(piece.content for piece in chunks))
    assert found.rows == own.says.rows


def test_another_runs_begin_does_not_lend_its_metadata_or_attachments(own, other, recovered):
    recovery, found = recovered(beginning(other) + own.content[len(beginning(own)) :])
    assert found.rows == own.says.rows
    assert (recovery.metadata_lost, found.attachments) == (True, {})
    assert found.run == own.says.run
    assert "seed" not in found.metadata


def test_without_the_metadata_nothing_vouches_for_an_attachment(own, recovered):
    [metadata] = pieces(own, "metadata")
    recovery, found = recovered(flipped(own.content, metadata.begin + 30))
    assert (recovery.metadata_lost, recovery.attachments, recovery.complete) == (True, (), False)
    assert (found.rows, found.episodes, found.attachments) == (own.says.rows, own.says.episodes, {})


def test_an_attachment_of_another_run_is_not_taken_for_the_runs_own(own, other, recovered):
    [mine, _], [theirs, _] = pieces(own, "attachment"), pieces(other, "attachment")
    recovery, found = recovered(own.content.replace(mine.content, theirs.content))
    assert recovery.attachments_lost == ("config.yaml",)
    assert found.attachments == {"track.json": own.says.attachments["track.json"]}


def test_a_damaged_attachment_is_left_out_and_named(own, recovered):
    attachment = pieces(own, "attachment")[1]
    recovery, found = recovered(flipped(own.content, attachment.begin + len(attachment.content) - 8))
    assert (recovery.attachments, recovery.attachments_lost) == (("config.yaml",), ("track.json",))
    assert found.metadata == own.says.metadata
    assert not recovery.complete


def test_a_damaged_summary_costs_nothing_but_the_knowledge_that_the_log_was_finished(own, recovered):
    recovery, found = recovered(flipped(own.content, len(own.content) - 60))
    assert found == own.says
    assert (recovery.finished, recovery.transitions_lost, recovery.complete) == (False, 0, False)


def test_a_second_part_of_a_run_is_recovered_as_such(tmp_path, transitions):
    with LogWriter(tmp_path / "a.mcap", None, 1, 2**20, schema=make_schema(), attachments={}, metadata={}) as writer:
        while writer.path == tmp_path / "a.mcap":
            writer.write(transitions(4000))
    recovery = recover(tmp_path / "a-1.mcap", tmp_path / "new.mcap")
    assert (recovery.transitions_lost, recovery.complete) == (0, True)
    found = read_contents(tmp_path / "new.mcap")
    assert found == read_contents(tmp_path / "a-1.mcap")
    assert found.metadata["part"] == "1"


def test_a_batch_with_another_number_of_rays_is_left_out(tmp_path, transitions, recovered):
    own = write_log(tmp_path / "own.mcap", transitions, batches=2)
    with LogWriter(tmp_path / "wide.mcap", schema=make_schema(9), attachments={}, metadata={}) as writer:
        writer.write(transitions(5, rays=9))
    wide = Batch(make_schema(9), int(own.says.run, 16), 2 * BATCH, read_columns(tmp_path / "wide.mcap")).encode()
    content = RecordBuilder()
    Message(CHANNELS[TRANSITIONS], 10**12, wide, 10**12, 0).write(content)
    recovery, found = recovered(own.content + chunk_record(bytes(content.end()), (10**12, 10**12)))
    assert (found.rows, recovery.transitions_lost) == (own.says.rows, 0)


def test_messages_that_are_none_of_the_format_are_left_out(own, recovered):
    content = RecordBuilder()
    for channel in (CHANNELS[TRANSITIONS], CHANNELS[EPISODES], 77):
        Message(channel, 0, b"\xff" * 40, 0, 0).write(content)
    _, found = recovered(own.content + chunk_record(bytes(content.end())) + chunk_record(b"\x05\xff"))
    assert found == own.says


@pytest.mark.parametrize("content", [MCAP0_MAGIC[:1], MCAP0_MAGIC, MCAP0_MAGIC + bytes(100), 2 * MCAP0_MAGIC])
def test_a_log_of_which_nothing_but_its_mark_is_left_gives_an_empty_one(recovered, content):
    recovery, found = recovered(content)
    assert (found.rows, found.episodes, found.metrics, found.attachments) == ([], [], [], {})
    assert recovery.metadata_lost


def test_a_piece_in_the_midst_of_something_else_is_found(own, recovered):
    chunk = pieces(own, "chunk", TRANSITIONS)[0]
    recovery, found = recovered(bytes(1000) + b"text" * 50 + chunk.content + bytes(1000))
    assert found.rows == own.says.rows[:BATCH]
    assert recovery.metadata_lost


def test_a_piece_within_a_damaged_record_is_found(own, recovered):
    builder = RecordBuilder()
    Attachment(0, 0, "notes.txt", "text/plain", pieces(own, "chunk", TRANSITIONS)[0].content).write(builder)
    attachment = bytes(builder.end())
    _, found = recovered(flipped(attachment, len(attachment) - 1))
    assert found.rows == own.says.rows[:BATCH]


def test_a_chunk_without_a_crc_is_not_trusted(own, recovered):
    content = RecordBuilder()
    message = encode_small(
        METRICS,
        int(own.says.run, 16),
        Metrics(9, 3, 0.25, 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99}),
    )
    Message(CHANNELS[METRICS], 10**12, message, 10**12, sequence=BATCHES).write(content)
    unpacked = bytes(content.end())
    assert len(recovered(own.content + chunk_record(unpacked))[1].metrics) == BATCHES + 1
    assert recovered(own.content + chunk_record(unpacked, crc=0))[1] == own.says


def fake_heads(opcode):
    """Heads of records of 60 MiB, one after the other; what follows could be theirs."""
    body = {
        Opcode.CHUNK: bytes(28) + b"\x04\0\0\0zstd" + struct.pack("<Q", 60 * 2**20 - 44),
        Opcode.ATTACHMENT: bytes(16) + struct.pack("<I", 60_000),
        Opcode.METADATA: b"\x05\0\0\0carrl" + struct.pack("<I", 60 * 2**20 - 13),
    }[opcode]
    return 300_000 * (struct.pack("<BQ", opcode, 60 * 2**20) + body)


def false_bombs():
    """Chunks that unpack to 64 MiB of zeros, and then have another CRC."""
    return 500 * chunk_record(bytes(2**26), crc=1)


def true_bombs():
    """Intact chunks of half a million messages each that say nothing."""
    content = RecordBuilder()
    Message(CHANNELS[METRICS], 0, b"", 0, 0).write(content)
    return 50 * chunk_record(2**19 * bytes(content.end()))


@pytest.mark.parametrize(
    "content",
    [fake_heads(Opcode.CHUNK), fake_heads(Opcode.ATTACHMENT), fake_heads(Opcode.METADATA), false_bombs(), true_bombs()],
    ids=["chunks", "attachments", "metadata", "false bombs", "true bombs"],
)
def test_a_file_made_to_keep_recovery_busy_is_given_up_after_some_work(tmp_path, content):
    (tmp_path / "hostile.mcap").write_bytes(MCAP0_MAGIC + content)
    recovered = []
    calls = count_calls(lambda: recovered.append(recover(tmp_path / "hostile.mcap", tmp_path / "new.mcap")))
    assert recovered[0].transitions == 0
    assert calls < 20_000_000


def test_the_search_does_not_lose_patience_with_a_log_that_is_as_training_wrote_it(own, recovered, monkeypatch):
    monkeypatch.setattr("carrl.log.salvage._PATIENCE_BYTES", 0)
    assert recovered(own.content)[1] == own.says


def test_a_target_that_exists_is_left_alone(own, tmp_path):
    (tmp_path / "new.mcap").write_text("precious")
    with pytest.raises(LogError, match=r"new\.mcap': is there already; give the name of a new file"):
        recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    with pytest.raises(LogError, match="is there already"):
        recover(tmp_path / "own.mcap", tmp_path / "own.mcap")
    assert (tmp_path / "new.mcap").read_text() == "precious"
    assert (tmp_path / "own.mcap").read_bytes() == own.content


def without_hard_links(*_):
    raise OSError(errno.EPERM, os.strerror(errno.EPERM))


@pytest.mark.parametrize("link", [os.link, without_hard_links], ids=["hard links", "no hard links"])
def test_of_two_recoveries_into_one_file_one_succeeds_and_the_other_is_refused(own, tmp_path, monkeypatch, link):
    """The second one begins, and ends, while the first one is about to finish."""
    monkeypatch.setattr("os.link", link)
    finish, second = McapFile.finish, []

    def finish_later(file):
        monkeypatch.setattr(McapFile, "finish", finish)
        second.append(recover(tmp_path / "own.mcap", tmp_path / "new.mcap"))
        finish(file)

    monkeypatch.setattr(McapFile, "finish", finish_later)
    with pytest.raises(LogError, match=r"new\.mcap': is there already; give the name of a new file"):
        recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    assert [recovery.complete for recovery in second] == [True]
    assert read_contents(tmp_path / "new.mcap") == own.says
    assert {path.name for path in tmp_path.iterdir()} == {"own.mcap", "new.mcap"}


@pytest.mark.parametrize("place", ["missing/new.mcap", "file/new.mcap", "a\0.mcap", "x" * 300])
def test_a_target_that_cannot_be_written_is_named(own, tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match=r"cannot be written: .*; give another place for it"):
        recover(tmp_path / "own.mcap", tmp_path / place)
    assert {path.name for path in tmp_path.iterdir()} == {"own.mcap", "file"}


def test_a_disk_that_fills_up_leaves_no_half_of_a_log(own, tmp_path, monkeypatch):
    written = []

    def fill_up(descriptor, content, offset):
        written.append(len(content))
        if sum(written) > len(own.content) / 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.pwrite(descriptor, content, offset)

    monkeypatch.setattr("carrl.log.mcap_write._write_at", fill_up)
    with pytest.raises(LogError, match="cannot be written: No space left on device"):
        recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["own.mcap"]


def test_an_interrupted_recovery_leaves_no_half_of_a_log(own, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("carrl.log.recovery.record_at", interrupt)
    with pytest.raises(KeyboardInterrupt):
        recover(tmp_path / "own.mcap", tmp_path / "new.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["own.mcap"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.mcap", "cannot be read: No such file or directory"),
        ("empty.mcap", "is empty, 0 bytes"),
        ("text.mcap", "holds nothing of a CarRL log; give the train.mcap of a run"),
        ("folder", "is a folder; give a file"),
        ("a\0.mcap", "embedded null"),  # "byte" in Python 3.11, "character in path" in 3.13
    ],
)
def test_a_source_that_is_no_log_is_refused(tmp_path, name, words):
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("I am a text file. " * 100)
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match=re.escape(words)):
        recover(tmp_path / name, tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()


def test_an_mcap_file_of_another_program_gives_no_transitions(tmp_path):
    begin_log(tmp_path / "a.mcap", describe(1, 0, {}, {}), {}, make_schema()).close()
    content = (tmp_path / "a.mcap").read_bytes().replace(b"carrl", b"other")
    (tmp_path / "b.mcap").write_bytes(content)
    assert recover(tmp_path / "b.mcap", tmp_path / "c.mcap").transitions == 0


def test_an_attachment_without_a_crc_is_not_trusted(own, recovered):
    builder = RecordBuilder()
    content = own.says.attachments["track.json"]
    Attachment(0, 0, "track.json", "application/json", content).write(builder)
    unchecked = bytes(builder.end())[:-4] + bytes(4)
    mine = pieces(own, "attachment")[1]
    recovery, _ = recovered(own.content.replace(mine.content, unchecked))
    assert recovery.attachments_lost == ("track.json",)


def test_refusals_are_damaged_log_errors_where_the_file_is_readable(tmp_path):
    (tmp_path / "a.mcap").write_text("no log")
    with pytest.raises(DamagedLogError):
        recover(tmp_path / "a.mcap", tmp_path / "new.mcap")
