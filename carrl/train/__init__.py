"""A run: its trainer, folder and checkpoints. `carrl.train(...)` trains one: see `carrl.train.run.train`."""

import inspect
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carrl.train.run import Run


class _CallableModule(ModuleType):
    """This package, which is the function `carrl.train`, too: Python has one attribute for both."""

    def __call__(self, *arguments: Any, **keywords: Any) -> "Run":
        """Trains, as `carrl.train.run.train` says."""
        from carrl.train.run import train  # here, since it imports torch

        return train(*arguments, **keywords)

    @property
    def __signature__(self) -> inspect.Signature:
        """What it takes, for `inspect.signature` and what shows it while one types."""
        from carrl.train.run import train

        return inspect.signature(train)


sys.modules[__name__].__class__ = _CallableModule
