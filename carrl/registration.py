"""Makes CarRL known to Gymnasium and to TorchRL once both are imported, in either order.

Neither has entry points for plugins, and importing them here would take as long as `carrl log` may take to start.
"""

import importlib.util
import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def register_with_gymnasium() -> None:
    """Registers the environment `carrl/Track-v0` now, or as soon as Gymnasium is imported."""
    _register_after("gymnasium", _register_environments)


def register_with_torchrl() -> None:
    """Registers the data set `carrl:PATH` now, or as soon as TorchRL's data sets are imported."""
    _register_after("torchrl.data.datasets.utils", _register_dataset)


def _register_environments() -> None:
    import gymnasium

    gymnasium.register(
        "carrl/Track-v0",
        entry_point="carrl.env.gym_env:GymTrackEnv",
        vector_entry_point="carrl.env.gym_vector_env:GymVectorTrackEnv",
        max_episode_steps=1000,
    )


def _register_dataset() -> None:
    from torchrl.data.datasets.utils import register_dataset

    register_dataset("carrl", "carrl.data.logs:CarRLExperienceReplay", replace=True)


def _register_after(module: str, register: Callable[[], None]) -> None:
    """Registers now if the module is there, else right after its import."""
    if module in sys.modules:
        register()
    else:
        sys.meta_path.insert(0, _Finder(module, register))


class _Finder(MetaPathFinder):
    """Finds a module as Python would, and lets registration follow its import, but not a mere search for it."""

    def __init__(self, module: str, register: Callable[[], None]) -> None:
        self._module, self._register = module, register
        self._is_searching = False

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Finds this one module, until it is imported."""
        if name != self._module or self._is_searching:
            return None
        self._is_searching = True
        try:
            spec = importlib.util.find_spec(name)
        finally:
            self._is_searching = False
        if spec is not None and spec.loader is not None:
            spec.loader = _RegisteringLoader(spec.loader, self._import)
        return spec

    def _import(self) -> None:
        if self in sys.meta_path:
            sys.meta_path.remove(self)
        self._register()


class _RegisteringLoader(Loader):
    def __init__(self, loader: Loader, register: Callable[[], None]) -> None:
        self._loader, self._register = loader, register

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        module.__spec__.loader = module.__loader__ = self._loader  # from here on it is as if nobody had looked on
        self._loader.exec_module(module)
        self._register()
