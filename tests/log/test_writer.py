"""The order of records in the file, what is on disk when, and each way in which writing can fail."""

import contextlib
import os
import re
import resource
from pathlib import Path

import pytest
import torch
from mcap.exceptions import EndOfFile
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from carrl.errors import LogError
from carrl.log import Log, load, read_columns, read_summary, verify
from carrl.log import writer as writer_module
from carrl.log.schema import CHANNELS, EPISODES, METRICS, TRANSITIONS, Column
from carrl.log.schema import Schema as LogSchema
from carrl.log.writer import LogWriter
from tests.logs import make_schema


def new_writer(path, *options, **metadata):
    return LogWriter(path, *options, schema=make_schema(), attachments={"config.yaml": b"seed: 1\n"}, metadata=metadata)


def records_on_disk(path, emit_chunks=False):
    found = []
    with open(path, "rb") as file, contextlib.suppress(EndOfFile):
        for record in StreamReader(file, emit_chunks=emit_chunks).records:
            found.append(record)
    return found


def messages_on_disk(path):
    return [record for record in records_on_disk(path) if isinstance(record, Message)]


def is_open(path):
    links = [Path("/proc/self/fd", name) for name in os.listdir("/proc/self/fd")]
    return any(os.readlink(link) == str(path) for link in links if link.is_symlink())


@contextlib.contextmanager
def files_limited_to(size):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))  # Python ignores SIGXFSZ: writing gives EFBIG
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_metadata_and_attachments_come_before_the_first_chunk(log_path):
    kinds = [type(record) for record in records_on_disk(log_path, emit_chunks=True)]
    assert kinds[1:4] == [Metadata, Attachment, Attachment]
    assert kinds[4:10] == [Schema, Channel] * 3
    assert kinds[10] is Chunk


def test_attachments_are_on_disk_before_the_first_batch(tmp_path):
    with new_writer(tmp_path / "a.mcap", track="oval"):
        [_, metadata, attachment, *_] = records_on_disk(tmp_path / "a.mcap")
    assert metadata.metadata["track"] == "oval"
    assert (attachment.name, attachment.data, attachment.media_type) == (
        "config.yaml",
        b"seed: 1\n",
        "application/yaml",
    )


def test_flush_puts_every_batch_on_disk(tmp_path, transitions):
    with new_writer(tmp_path / "a.mcap") as writer:
        writer.write(transitions(3))
        assert messages_on_disk(tmp_path / "a.mcap") == []
        writer.flush()
        assert len(messages_on_disk(tmp_path / "a.mcap")) == 1


def test_a_batch_that_comes_after_the_flush_interval_takes_the_earlier_ones_to_disk(tmp_path, transitions, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(writer_module.time, "monotonic", lambda: clock[0])
    with new_writer(tmp_path / "a.mcap") as writer:
        for clock[0], on_disk in ((100.0, 0), (100.4, 0), (100.5, 3), (100.9, 3), (101.1, 5)):
            writer.write(transitions(3))
            assert len(messages_on_disk(tmp_path / "a.mcap")) == on_disk


def test_a_batch_bears_the_times_of_its_last_and_its_first_transition(log_path):
    times = [(message.log_time, message.publish_time) for message in messages_on_disk(log_path)]
    # Four, one and four transitions, a tenth of a second apart; then two episodes and the metrics.
    assert times[:3] == [(300_000_000, 0), (400_000_000, 400_000_000), (800_000_000, 500_000_000)]
    assert times[3:] == [(500_000_000,) * 2, (900_000_000,) * 2, (800_000_000,) * 2]


def test_episodes_and_metrics_have_chunks_of_their_own(log_path):
    with Log(log_path) as log:
        topics = [chunk.message_index_offsets.keys() for chunk in log._file.index.chunks]
    assert topics == [{CHANNELS[TRANSITIONS]}, {CHANNELS[EPISODES], CHANNELS[METRICS]}]


def test_close_can_be_called_twice_and_flush_after_it(tmp_path):
    writer = new_writer(tmp_path / "a.mcap")
    for action in (writer.close, writer.close, writer.flush):
        action()
    assert writer.closed


def test_writing_after_close_is_refused(tmp_path, transitions):
    writer = new_writer(tmp_path / "a.mcap")
    writer.close()
    with pytest.raises(LogError, match=r"a\.mcap': it is closed"):
        writer.write(transitions(1))


def test_an_error_inside_the_with_statement_still_completes_the_file(tmp_path, transitions):
    with pytest.raises(RuntimeError, match="diverged"), new_writer(tmp_path / "a.mcap") as writer:
        writer.write(transitions(3))
        raise RuntimeError("the run diverged")
    assert read_summary(tmp_path / "a.mcap").transitions == 3


def test_an_interrupted_write_leaves_a_readable_log_of_what_was_written_before(tmp_path, transitions, monkeypatch):
    def interrupt(descriptor, content, offset):
        os.pwrite(descriptor, content[: len(content) // 2], offset)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), new_writer(tmp_path / "a.mcap") as writer:
        writer.write(transitions(3))
        writer.flush()
        writer.write(transitions(3))
        with monkeypatch.context() as context:
            context.setattr("carrl.log.mcap_write._write_at", interrupt)
            writer.flush()
    assert verify(tmp_path / "a.mcap").transitions in (3, 6)


def test_a_refused_batch_leaves_the_log_as_it_was(tmp_path, transitions):
    with new_writer(tmp_path / "a.mcap") as writer:
        writer.write(transitions(3))
        with pytest.raises(LogError):
            writer.write(transitions(3, rays=8))
        writer.write(transitions(2))
    assert read_summary(tmp_path / "a.mcap").transitions == 5


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("pose", None, "'state': the transitions have no key 'pose'"),
        (("next", "reward_terms"), None, "no key ('next', 'reward_terms')"),
        ("pose", torch.zeros(4, 2), "'state' has shape [2] for each transition; expected [3]"),
        (("next", "reward"), torch.zeros(4), "'reward' has shape [] for each transition; expected [1]"),
        ("observation", torch.zeros(4), "'observation' has shape [] for each transition; expected [7]"),
        ("observation", torch.zeros(4, 7).double(), "'observation' has type float64; expected float32"),
        (
            ("next", "observation"),
            torch.zeros(4, 8),
            "'next_observation' has shape [8] for each transition; expected [7]",
        ),
        ("action", torch.tensor([0, 1, 2, 2**31]), "'action' holds 0..2147483648; it must lie in -2147483648.."),
    ],
)
def test_a_batch_that_does_not_fit_the_table_is_refused_by_column(tmp_path, transitions, key, value, words):
    batch = transitions(4)
    if value is None:
        del batch[key]
    else:
        batch[key] = value
    with new_writer(tmp_path / "a.mcap") as writer, pytest.raises(LogError) as caught:
        writer.write(batch)
    assert words in str(caught.value)
    assert "a.mcap" in str(caught.value)


def test_the_number_of_rays_must_stay_the_same_within_a_file(tmp_path, transitions):
    with new_writer(tmp_path / "a.mcap") as writer:
        writer.write(transitions(4, rays=7))
        with pytest.raises(LogError, match=r"'observation' has shape \[9\] for each transition; expected \[7\]"):
            writer.write(transitions(4, rays=9))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ([Column("log_prob", "log_prob", "float16")], "column 'log_prob' has type 'float16', which no log has"),
        ([Column("Log Prob", "log_prob", "float32")], "a column is called 'Log Prob'"),
        ([Column("count", "count", "int64")], "a column is called 'count'"),
        ([Column("mean", "mean", "float32", (2, 2))], "column 'mean' has shape [2, 2]; it must be [] or [width]"),
        ([Column("mean", "mean", "float32", (2,), "", ("steer",))], "column 'mean' is 2 wide for 1 names"),
        ([Column("action", "action", "int64")], "its 18 columns have 17 names"),
    ],
)
def test_columns_that_a_log_cannot_have_are_refused(tmp_path, columns, words):
    with pytest.raises(LogError, match=re.escape(words)):
        LogWriter(tmp_path / "a.mcap", schema=make_schema(algorithm=columns), attachments={}, metadata={})
    assert not (tmp_path / "a.mcap").exists()


def test_a_log_has_every_column_of_the_task(tmp_path):
    schema = LogSchema(make_schema().task[:-1], ())
    with pytest.raises(LogError, match="it has no column 'time_ns', which every log has"):
        LogWriter(tmp_path / "a.mcap", schema=schema, attachments={}, metadata={})


def test_a_batch_that_is_not_flat_is_refused(tmp_path, transitions):
    with new_writer(tmp_path / "a.mcap") as writer, pytest.raises(LogError, match=r"\[2, 3\]; flatten it to \[T\]"):
        writer.write(transitions(6).reshape(2, 3))


@pytest.mark.parametrize("times", [[0, 0, 2, 1], [-1, 0, 0, 0], [4, 5, 6, 7]])
def test_times_that_go_back_are_refused(tmp_path, transitions, times):
    batch, earlier = transitions(4), transitions(1)
    batch["time_ns"], earlier["time_ns"] = torch.tensor(times), torch.tensor([5])
    with new_writer(tmp_path / "a.mcap") as writer:
        if times[0] >= 0 and times == sorted(times):
            writer.write(earlier)
        with pytest.raises(LogError, match="'time_ns' decreases, or begins before"):
            writer.write(batch)


def test_only_the_first_cars_are_logged_if_so_configured(tmp_path, transitions):
    batch = transitions(30)
    with new_writer(tmp_path / "a.mcap", 2) as writer:
        writer.write(batch)
    assert read_columns(tmp_path / "a.mcap")["time_ns"].tolist() == batch["time_ns"][batch["car"] < 2].tolist()


def test_only_every_nth_episode_is_logged_if_so_configured(tmp_path, transitions):
    batch = transitions(30)  # six episodes of five steps
    with new_writer(tmp_path / "a.mcap", None, 3) as writer:
        writer.write(batch)
        writer.write(transitions(0))
    assert read_columns(tmp_path / "a.mcap")["episode"].tolist() == [0] * 5 + [3] * 5
    assert read_summary(tmp_path / "a.mcap").transitions == 10


def test_a_log_above_its_size_goes_on_in_another_file(tmp_path, transitions):
    batches = [transitions(4000, seed=seed) for seed in range(11)]
    with new_writer(tmp_path / "a.mcap", None, 1, 2**20, track="oval") as writer:
        for batch in batches:
            writer.write(batch)
        assert writer.path == tmp_path / "a-2.mcap"
    parts = [tmp_path / "a.mcap", *(tmp_path / f"a-{part}.mcap" for part in (1, 2))]
    assert sorted(tmp_path.iterdir()) == sorted(parts)
    assert all(2**20 <= part.stat().st_size < 2 * 2**20 for part in parts[:-1])
    assert torch.cat([load(part)["observation"] for part in parts]).equal(
        torch.cat([b["observation"] for b in batches])
    )
    summaries = [read_summary(part) for part in parts]
    assert [summary.metadata["part"] for summary in summaries] == ["0", "1", "2"]
    assert len({summary.metadata["run"] for summary in summaries}) == 1
    assert all(verify(part).transitions == summary.transitions for part, summary in zip(parts, summaries, strict=True))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((0,), "recorder.envs is 0"),
        ((None, 0), "recorder.every_nth_episode is 0"),
        ((None, 1, 10), "max_file_bytes is 10"),
    ],
)
def test_options_out_of_their_range_are_refused(tmp_path, options, words):
    with pytest.raises(LogError, match=words):
        new_writer(tmp_path / "a.mcap", *options)
    assert not (tmp_path / "a.mcap").exists()


def test_metadata_must_not_take_a_key_of_the_format(tmp_path):
    with pytest.raises(LogError, match="'format_version' is the format's own"):
        new_writer(tmp_path / "a.mcap", format_version="7")


@pytest.mark.parametrize("place", ["", "missing/a.mcap", "file/a.mcap", "a\0.mcap"])
def test_a_place_that_cannot_be_written_is_named(tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match=r"cannot be written: .*; give a file in an existing, writable folder"):
        new_writer(tmp_path / place)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is Linux's")
def test_a_disk_that_is_full_from_the_start_is_reported():
    with pytest.raises(LogError, match="/dev/full': cannot be written: No space left on device"):
        new_writer("/dev/full")
    assert not is_open("/dev/full")


def test_a_disk_that_fills_up_closes_the_log(tmp_path, transitions):
    path = tmp_path / "a.mcap"
    with files_limited_to(1_500_000), pytest.raises(LogError, match="cannot be written"), new_writer(path) as writer:
        for _ in range(100):
            writer.write(transitions(1000))
    assert writer.closed
    assert not is_open(path)
    assert 0 < verify(path).transitions < 100_000  # what fitted is a finished log
    with pytest.raises(LogError, match="it is closed"):
        writer.write(transitions(1))


def test_a_disk_that_fills_up_at_the_end_is_reported_by_close(tmp_path, transitions):
    writer = new_writer(tmp_path / "a.mcap")
    writer.write(transitions(1000))
    with files_limited_to(10_000), pytest.raises(LogError, match="cannot be written"):
        writer.close()
    assert writer.closed
    assert not is_open(tmp_path / "a.mcap")
