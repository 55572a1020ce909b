"""A log as one of TorchRL's offline data sets."""

import os
import subprocess
import sys

import pytest
import torch
from tensordict import MemoryMappedTensor, NonTensorData, TensorDict
from torchrl.data import SamplerWithoutReplacement, SliceSampler, TensorDictReplayBuffer
from torchrl.data.datasets import BaseDatasetExperienceReplay, load_dataset
from torchrl.data.datasets.utils import _DATASET_REGISTRY
from torchrl.envs.transforms import RewardScaling

from carrl.data.logs import CarRLExperienceReplay
from carrl.errors import LogError
from carrl.log import load
from carrl.registration import register_with_torchrl
from tests.data.logs import STEPS, logged_transitions, write_log


@pytest.fixture
def log_path(tmp_path):
    return write_log(tmp_path / "train.mcap")


@pytest.fixture
def make_dataset(tmp_path, log_path):
    """Makes the data set of the log, with its copy in a folder of the test."""

    def make(batch_size=4, path=log_path, **options):
        return CarRLExperienceReplay(path, batch_size, root=tmp_path / "copies", **options)

    return make


def test_transitions_stand_episode_by_episode_bit_for_bit(make_dataset, log_path):
    stored, logged = make_dataset()[:], load(log_path)
    order = sorted(range(len(STEPS)), key=lambda index: STEPS[index][1:])
    assert stored["episode"].tolist() == [0] * 3 + [1] * 5 + [2] * 2
    assert stored["step"].tolist() == [0, 1, 2, 0, 1, 2, 3, 4, 0, 1]
    for key in logged.keys(True, True):
        assert torch.equal(stored[key], logged[key][order])


def test_the_layout_is_that_of_torchrls_other_data_sets(make_dataset):
    dataset = make_dataset()
    assert isinstance(dataset, BaseDatasetExperienceReplay) and isinstance(dataset, TensorDictReplayBuffer)
    keys = {"observation", "action", "done", "terminated", "truncated"}
    following = {("next", key) for key in ("observation", "reward", "done", "terminated", "truncated")}
    stored = dataset[:]
    assert keys | following <= set(stored.keys(include_nested=True))
    assert stored["next", "done"].flatten().nonzero().flatten().tolist() == [2, 7]
    assert not stored["done"].any() and stored["done"].shape == (10, 1)


def test_it_lies_in_memory_mapped_files(make_dataset):
    dataset = make_dataset()
    assert all(isinstance(tensor, MemoryMappedTensor) for tensor in dataset.storage._storage.values(True, True))
    assert (dataset.data_path / "observation.memmap").stat().st_size == 10 * 7 * 4


def test_samples_have_the_batch_size_and_pass_the_transform(make_dataset):
    scaled = make_dataset(transform=RewardScaling(0.0, 2.0, in_keys=[("next", "reward")])).sample()
    assert scaled.batch_size == (4,)
    torch.testing.assert_close(scaled["next", "reward"], scaled["observation"][:, :1] * 200)


def test_an_epoch_visits_every_transition_once(make_dataset):
    batches = list(make_dataset(batch_size=5, sampler=SamplerWithoutReplacement()))
    seen = torch.cat([torch.stack([batch["episode"], batch["step"]], -1) for batch in batches])
    assert sorted(map(tuple, seen.tolist())) == sorted((episode, step) for _, episode, step in STEPS)


def test_slices_of_episodes_can_be_sampled(make_dataset):
    slices = make_dataset(batch_size=8, sampler=SliceSampler(num_slices=4, traj_key="episode")).sample().view(4, 2)
    assert (slices["episode"][:, 0] == slices["episode"][:, 1]).all()
    assert (slices["step"][:, 1] == slices["step"][:, 0] + 1).all()


def test_split_trajectories_are_padded_and_masked(make_dataset, log_path):
    dataset = make_dataset(batch_size=2, split_trajs=True)
    stored = dataset[:]
    assert stored.batch_size == (3, 5)
    assert stored["mask"].sum(-1).tolist() == [3, 5, 2]
    assert dataset.sample().batch_size == (2, 5)
    plain = make_dataset()[:]
    for key in load(log_path).keys(True, True):
        assert torch.equal(stored[key][stored["mask"]], plain[key])
    assert not stored["observation"][~stored["mask"]].any()


def test_the_log_is_read_once_and_again_when_it_has_changed(make_dataset, log_path, monkeypatch):
    dataset = make_dataset()
    monkeypatch.setattr("carrl.data.logs.fill", None)
    assert make_dataset().data_path == dataset.data_path
    monkeypatch.undo()
    write_log(log_path, logged_transitions()[:6])
    os.utime(log_path, ns=(1, 1))
    assert len(make_dataset()) == 6 and len(dataset) == 10


def test_delete_removes_the_copy_and_not_the_log(make_dataset, log_path):
    dataset = make_dataset()
    dataset.delete()
    assert not dataset.data_path.exists()
    assert log_path.exists()


def test_it_refuses_to_be_written_to(make_dataset):
    with pytest.raises(RuntimeError, match="allow writing"):
        make_dataset().extend(TensorDict({}, [1]))


def test_a_bad_log_leaves_nothing_behind(make_dataset, log_path, tmp_path):
    with pytest.raises(LogError, match="holds no transitions"):
        make_dataset(path=write_log(tmp_path / "empty.mcap", logged_transitions()[:0]))
    content = log_path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    with pytest.raises(LogError, match=r"cut\.mcap"):
        make_dataset(path=tmp_path / "cut.mcap")
    with pytest.raises(LogError, match=r"nowhere\.mcap': cannot be read"):
        make_dataset(path=tmp_path / "nowhere.mcap")
    assert not list((tmp_path / "copies").glob("*"))


def test_a_root_that_cannot_be_written_is_refused(log_path, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match=r"its copy in '.*file' cannot be written: .*; give another root"):
        CarRLExperienceReplay(log_path, 4, root=tmp_path / "file")


class MakesFolder:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_a_pickle_in_a_copy_is_not_loaded(make_dataset, tmp_path):
    copy = make_dataset().data_path
    TensorDict({"action": NonTensorData(MakesFolder(tmp_path / "made"))}).memmap(copy)
    with pytest.raises(RuntimeError, match="pickle"):
        make_dataset()
    assert not (tmp_path / "made").exists()


def test_torchrl_loads_it_by_its_prefix(log_path, tmp_path):
    register_with_torchrl()
    dataset = load_dataset(f"carrl:{log_path}", batch_size=4, root=tmp_path)
    assert isinstance(dataset, CarRLExperienceReplay)
    assert "carrl" in _DATASET_REGISTRY


@pytest.mark.parametrize("first", ["register_with_torchrl()", "import torchrl.data.datasets"])
def test_registering_works_before_and_after_torchrls_import_and_imports_nothing_itself(first, log_path, tmp_path):
    program = f"""
import sys
from carrl.registration import register_with_torchrl
{first}
assert first_imported == ("torchrl" in sys.modules), "registering imports torchrl"
register_with_torchrl()
from torchrl.data.datasets import load_dataset
print(len(load_dataset("carrl:{log_path}", batch_size=4, root={str(tmp_path)!r})))
""".replace("first_imported", str(first.startswith("import")))
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stdout.strip() == "10", ran.stderr
