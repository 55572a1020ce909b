"""Makes `carrl/Track-v0` known to Gymnasium once both are imported, in either order.

Gymnasium 1.4 has no entry points for plugins, and importing it here would make `carrl log` start noticeably later.
"""

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def register_with_gymnasium() -> None:
    """Registers the environments now, or as soon as Gymnasium is imported."""
    if "gymnasium" in sys.modules:
        _register()
    else:
        sys.meta_path.insert(0, _GymnasiumFinder())


def _register() -> None:
    import gymnasium

    gymnasium.register(
        "carrl/Track-v0",
        entry_point="carrl.env.gym_env:GymTrackEnv",
        vector_entry_point="carrl.env.gym_vector_env:GymVectorTrackEnv",
        max_episode_steps=1000,
    )


class _GymnasiumFinder(MetaPathFinder):
    """Finds Gymnasium as Python would, once, and lets registration follow its import."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = _RegisteringLoader(spec.loader)
        return spec


class _RegisteringLoader(Loader):
    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        module.__spec__.loader = module.__loader__ = self._loader  # from here on it is as if nobody had looked on
        self._loader.exec_module(module)
        _register()
