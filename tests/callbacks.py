"""A callback for tests."""

from carrl.train.callbacks import Callback


class EachRound(Callback):
    """Calls a function with the trainer after every round."""

    def __init__(self, function):
        self._function = function

    def on_round(self, trainer):
        """Calls it."""
        self._function(trainer)
