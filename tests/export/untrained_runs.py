"""Folders of runs whose networks have random weights, in milliseconds."""

import torch
import yaml

from carrl.config import check_targets
from carrl.train.build import build_network, build_world
from carrl.train.checkpoint import save_checkpoint
from tests.configs import compose

ON_OVAL = {"_target_": "carrl.tracks.track.Track.load", "name_or_path": "oval"}


def write_untrained_run(folder, *overrides, seed=0, own=None, trust="examples/own_parts/own_parts.py"):
    """A run of this configuration, on the oval, with weights so large that it does not do the same everywhere.

    `own` has nodes of the configuration in the place of others, of parts in the module `trust`.
    """
    config = compose(*overrides, f"seed={seed}") | {"track": ON_OVAL} | (own or {})
    check_targets(config, [trust] if own else ())
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    network = build_network(config, build_world(config))
    generator = torch.Generator().manual_seed(seed)
    state = {
        name: torch.randn(value.shape, generator=generator) / max(1, value.shape[-1]) ** 0.5
        if _is_drawn(name)
        else value
        for name, value in network.state_dict().items()
    }
    for name in ("best", "last"):
        save_checkpoint(folder / "checkpoints" / f"{name}.pt", {"network": state})
    return folder


def _is_drawn(name):
    return name.endswith(("weight", "bias", "_mu", "_sigma", "_epsilon"))
