"""Logs whose every checksum is right, but not what they say; and logs with damaged bytes."""

import json
from functools import cached_property
from pathlib import Path
from random import Random

import numpy as np
from mcap.records import Message

from benchmarks.fuzz.mutation import mutate
from benchmarks.fuzz.parser import Parser
from benchmarks.fuzz.values import change
from carrl.algorithms.dqn.dqn import dqn_columns
from carrl.data.description import describe_run, log_schema
from carrl.env.track_env import TrackEnv
from carrl.errors import DamagedLogError, LogError
from carrl.log import Log, read_trace, recover, summarise, verify
from carrl.log.codec import Batch, Columns, encode_small
from carrl.log.log_file import begin_log, chunk_beginning, describe, with_checksum
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import CHANNELS, EPISODES, METRICS, TRANSITIONS, Schema

_STEPS, _RUN = 6, 0x1234567890ABCDEF
_TIMES = (0, 1, 10**8, 10**9, 2**40, 2**63 - 1)


class LogFile(Parser):
    """A log, as all verbs of `carrl log` and training on logs read it."""

    @property
    def path(self) -> Path:
        """Of the log."""
        return self.folder / "train.mcap"

    @cached_property
    def entries(self) -> dict[str, str]:
        """What a run says of itself."""
        return describe_run(TrackEnv("oval", num_envs=1, seed=0).task, 0, 1)

    @cached_property
    def schema(self) -> Schema:
        """The columns of such a run."""
        return log_schema(TrackEnv("oval", num_envs=1, seed=0).task, dqn_columns(("forward", "left", "right")))

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """A small track, and a configuration."""
        square = {"centreline": [[0, 0], [9, 0], [9, 9]], "walls": [[[0, 0], [9, 0]]], "gates": [[[0, 0], [0, 1]]]}
        return {"track.json": json.dumps({"name": "t", "length": 30.0, **square}).encode(), "config.yaml": b"seed: 0\n"}

    def make(self, draw: Random) -> None:
        """A log of a few messages, in which some say what no run does."""
        entries, attachments = dict(self.entries), dict(self.attachments)
        if draw.random() < 0.5:
            key = draw.choice(list(entries))
            entries[key] = self._text(draw, entries[key])
        if draw.random() < 0.3:
            name = draw.choice(list(attachments))
            attachments[name] = self._text(draw, attachments[name].decode()).encode("utf-8", "replace")
        if draw.random() < 0.1:
            attachments["\x1b[2J" * draw.choice((1, 50))] = b"x" * draw.choice((0, 9))
        metadata = describe(_RUN, 0, entries, attachments)
        if draw.random() < 0.1:
            metadata[draw.choice(list(metadata))] = draw.choice(("", "x", "2", "f" * 16))
            metadata = with_checksum(metadata)
        self.path.unlink(missing_ok=True)
        file = begin_log(self.path, metadata, attachments, self.schema)
        for _ in range(draw.choice((0, 1, 2, 3))):
            beginning = chunk_beginning(f"{_RUN:016x}", self.schema)
            file.add_chunk(
                self._messages(draw), mutate(draw, beginning, [beginning]) if draw.random() < 0.1 else beginning
            )
        file.finish()
        file.close()
        if draw.random() < 0.3:
            content = self.path.read_bytes()
            self.path.write_bytes(mutate(draw, content, [content]))

    def _text(self, draw: Random, text: str) -> str:
        """JSON with a value changed, or its text."""
        try:
            return json.dumps(change(draw, json.loads(text)), allow_nan=True)
        except ValueError:
            return mutate(draw, text.encode(), [b"{}"]).decode("utf-8", "replace")

    def _messages(self, draw: Random) -> list[Message]:
        run = _RUN if draw.random() < 0.95 else 7
        topic = draw.choice((TRANSITIONS, TRANSITIONS, EPISODES, METRICS))
        messages = []
        for number in range(draw.choice((1, 1, 2, 3))):
            if topic == TRANSITIONS:
                offset = number * _STEPS if draw.random() < 0.9 else draw.choice((0, 1, 2**63))
                content = Batch(self.schema, run, offset, self._columns(draw)).encode()
            elif topic == EPISODES:
                ended = "collision" if draw.random() < 0.8 else "\x1b[31m"
                pose = (1.0, 2.0, 3.0)[: draw.choice((3, 3, 3, 2))]
                small = Episode(number, 0, 0, 9, 0, draw.choice(_TIMES), -1.5, 5, 1, 0, ended, pose)  # type: ignore
                content = encode_small(topic, run, small)
            else:
                content = encode_small(
                    topic,
                    run,
                    Metrics(number, 1, float("nan"), 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.9}),
                )
            if draw.random() < 0.15:
                content = mutate(draw, content, [content])
            channel = CHANNELS[topic] if draw.random() < 0.97 else draw.choice((0, 1, 2, 3, 4, 65535))
            time = draw.choice(_TIMES) if draw.random() < 0.1 else number * 10**9
            sequence = draw.choice((number, number, 2**32 - 1))
            messages.append(
                Message(channel_id=channel, log_time=time, publish_time=time, data=content, sequence=sequence)
            )
        return messages

    def _columns(self, draw: Random) -> Columns:
        columns = {c.name: np.zeros((_STEPS, *c.shape), c.dtype) for c in self.schema.columns}
        columns["step"], columns["time_ns"] = np.arange(_STEPS), np.arange(_STEPS) * 10**8
        for _ in range(draw.choice((0, 0, 1, 2))):
            values = columns[draw.choice(list(columns))]
            least, most = (-(2**31), 2**31 - 1) if values.dtype == np.int64 else (-np.inf, np.inf)
            values[draw.randrange(_STEPS)] = draw.choice((0, 1, 3, 1e6, least, most))
        return columns

    def feed(self) -> None:
        """Reads all of it, recovers it, verifies it; each must refuse by itself."""
        refused: LogError | None = None
        for read in (self._read, self._recover, self._verify):
            try:
                read()
            except LogError as error:
                refused = error
        if refused is not None:
            raise refused

    def _read(self) -> None:
        with Log(self.path) as log:
            summarise(log)
            episodes = {int(number) for number in log.columns()["episode"].tolist()}
            list(log.episodes())
            list(log.metrics())
            for name in log.attachments:
                log.attachment(name)
            for episode in sorted(episodes)[:2]:
                trace = read_trace(log, episode)
                trace.ray_ends()

    def _recover(self) -> None:
        target = self.folder / "mended.mcap"
        target.unlink(missing_ok=True)
        recover(self.path, target)
        try:
            verify(target)
        except DamagedLogError as error:
            if "format version" in str(error):  # its metadata are kept as they are
                return
            raise AssertionError(f"what was recovered is damaged: {error}") from error

    def _verify(self) -> None:
        verify(self.path)
