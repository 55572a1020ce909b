"""One episode as the content of an .rrd file.

What a step of the log holds is at the step's number on the timeline `step`; poses and rays are at the step that begins
there, and those after the last step at the number after it. The timeline `time` is simulated time since the episode
began.
"""

import hashlib
import uuid

import rerun as rr

from carrl.export.rerun import drawing, plots
from carrl.export.rerun.blueprint import episode_blueprint
from carrl.export.rerun.step_stream import StepStream
from carrl.log.trace import EpisodeTrace

SENDERS = (
    drawing.send_frames,
    drawing.send_track,
    drawing.send_trail,
    drawing.send_car,
    drawing.send_rays,
    plots.send_actions,
    plots.send_q_values,
    plots.send_rewards,
    plots.send_ranges,
    plots.send_epsilon,
    plots.send_events,
)


def recording_bytes(trace: EpisodeTrace, title: str) -> bytes:
    """The content of an .rrd file: the episode, and the blueprint that lays out the viewer."""
    recording = rr.RecordingStream("carrl", recording_id=_identity(trace), send_properties=False)
    memory = recording.memory_recording()
    recording.send_recording_name(title)
    recording.send_property("episode", _properties(trace))
    recording.send_blueprint(episode_blueprint(trace))
    stream = StepStream(recording, trace)
    for send in SENDERS:
        send(stream, trace)
    content = memory.drain_as_bytes()
    recording.disconnect()
    return content


def _identity(trace: EpisodeTrace) -> str:
    """A name that the same steps always get, and other steps never."""
    digest = hashlib.sha256()
    for name in sorted(trace.columns):
        digest.update(name.encode() + trace.columns[name].tobytes())
    return uuid.UUID(bytes=digest.digest()[:16]).hex


def _properties(trace: EpisodeTrace) -> rr.AnyValues:
    """What the viewer shows of the recording as a whole."""
    return rr.AnyValues(
        episode=trace.episode,
        car=trace.car,
        track=trace.track.name,
        steps=len(trace),
        episode_return=float(trace.rewards.sum()),
        gates=int(trace.gates_passed[-1]),
        ended=trace.ended,
        begins_at_s=float(trace.times[0]),
    )
