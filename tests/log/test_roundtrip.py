"""What was written comes back, bit for bit, here and in a reader that knows nothing of CarRL."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from carrl.log import codec, load, read_columns, read_summary
from carrl.log.schema import TRANSITIONS
from carrl.log.writer import LogWriter
from tests.logs import make_schema

INT32, INT64 = torch.iinfo(torch.int32), torch.iinfo(torch.int64)


def write(path, *batches):
    schema = make_schema(batches[0]["observation"].shape[1])
    with LogWriter(path, schema=schema, attachments={}, metadata={}) as writer:
        for batch in batches:
            writer.write(batch)


def assert_same_bits(found, expected):
    for column in make_schema().columns:
        assert found[column.key].dtype == expected[column.key].dtype
        assert found[column.key].shape == expected[column.key].shape
        assert found[column.key].numpy().tobytes() == expected[column.key].numpy().tobytes(), column.name


def test_batches_of_different_lengths_come_back_in_order_and_bit_for_bit(tmp_path, transitions):
    batches = [transitions(count, seed=count) for count in (1, 16, 2, 500, 1, 33)]
    write(tmp_path / "a.mcap", *batches)
    assert_same_bits(load(tmp_path / "a.mcap"), torch.cat(batches))


def test_a_thousand_batches_of_one_transition_come_back(tmp_path, transitions):
    whole = transitions(2100)
    write(tmp_path / "a.mcap", *whole.split(1))
    assert_same_bits(load(tmp_path / "a.mcap"), whole)


def test_nan_payloads_negative_zero_infinities_and_subnormals_survive(tmp_path, transitions):
    batch = transitions(7)
    patterns = [0x7FC00000, 0x7FC12345, 0xFFC00001, 0x7F800000, 0x80000000, 0x00000001, 0xFF7FFFFF]
    special = torch.from_numpy(np.array(patterns, "<u4").view("<f4"))
    batch["observation"] = special.repeat(7, 1)
    batch["next", "reward"] = special[:, None]
    batch["epsilon"] = special.clone()
    write(tmp_path / "a.mcap", batch)
    assert_same_bits(load(tmp_path / "a.mcap"), batch)


def test_the_extremes_of_each_integer_column_survive(tmp_path, transitions):
    batch = transitions(2)
    batch["episode"] = torch.tensor([INT64.min, INT64.max])
    batch["time_ns"] = torch.tensor([0, INT64.max])
    for key in ("action", "step", "car", "track"):
        batch[key] = torch.tensor([INT32.min, INT32.max])
    write(tmp_path / "a.mcap", batch)
    assert_same_bits(load(tmp_path / "a.mcap"), batch)


@pytest.mark.parametrize("rays", [0, 1, 31])
def test_any_number_of_rays_comes_back(tmp_path, transitions, rays):
    batch = transitions(3, rays=rays)
    write(tmp_path / "a.mcap", batch)
    assert_same_bits(load(tmp_path / "a.mcap"), batch)


def test_a_batch_too_large_for_one_message_is_split_and_comes_back_whole(tmp_path, transitions, monkeypatch):
    monkeypatch.setattr(codec, "MAX_MESSAGE_BYTES", 1500)
    batch = transitions(100)
    write(tmp_path / "a.mcap", batch)
    assert read_summary(tmp_path / "a.mcap").messages[TRANSITIONS] > 5
    assert_same_bits(load(tmp_path / "a.mcap"), batch)


def test_strided_and_expanded_tensors_are_written_by_value(tmp_path, transitions):
    batch = transitions(8)[::2]
    batch["epsilon"] = torch.tensor(0.25).expand(4)
    write(tmp_path / "a.mcap", batch)
    assert_same_bits(load(tmp_path / "a.mcap"), batch)


def test_loading_adds_done_and_gives_writable_tensors(tmp_path, transitions):
    batch = transitions(50)
    write(tmp_path / "a.mcap", batch)
    loaded = load(tmp_path / "a.mcap")
    assert loaded.batch_size == torch.Size([50])
    assert torch.equal(loaded["next", "done"], batch["next", "terminated"] | batch["next", "truncated"])
    loaded["observation"].zero_()
    assert all(values.flags.writeable for values in read_columns(tmp_path / "a.mcap").values())


def test_a_log_without_transitions_loads_empty(tmp_path, transitions):
    write(tmp_path / "a.mcap", transitions(0))
    assert load(tmp_path / "a.mcap").batch_size == torch.Size([0])
    summary = read_summary(tmp_path / "a.mcap")
    assert (summary.messages[TRANSITIONS], summary.transitions, summary.start_time_s) == (0, 0, None)


def test_loaded_transitions_can_be_extended_into_another_batch(tmp_path, transitions):
    write(tmp_path / "a.mcap", transitions(4))
    loaded = load(tmp_path / "a.mcap")
    assert isinstance(loaded, TensorDict)
    assert torch.cat([loaded, loaded]).batch_size == torch.Size([8])


@pytest.mark.slow
def test_a_million_transitions_come_back_bit_for_bit(tmp_path, transitions):
    whole = transitions(1_000_000)
    write(tmp_path / "a.mcap", *whole.split(2048))
    assert_same_bits(load(tmp_path / "a.mcap"), whole)
