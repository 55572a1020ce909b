"""A callback of one function."""

from carrl.train.callbacks import Callback


class AfterRounds(Callback):
    """Calls a function of the trainer after every round."""

    def __init__(self, call):
        self.on_round = call
