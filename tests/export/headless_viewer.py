"""Rerun's viewer without a window, for tests of what it draws."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

LAVAPIPE = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")
"""Mesa's software renderer, where Debian keeps it."""


@contextmanager
def headless_viewer(recording):
    """A viewer that has loaded the recording and draws into memory; skips where there is nothing to draw with."""
    port = free_port()
    command = [sys.executable, "-m", "rerun_cli", recording, "--headless", "--window-size", "1600x1000"]
    environment = {**os.environ, "CI": "1"}  # with CI set, Rerun sends no statistics home
    if LAVAPIPE.exists():
        environment["VK_ICD_FILENAMES"] = str(LAVAPIPE)
    with subprocess.Popen(
        [*command, "--bind", "127.0.0.1", "--port", str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            yield connected(process, f"rerun+http://127.0.0.1:{port}/proxy")
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)  # the viewer is a child of this process, in its group


def connected(process, url, patience=120):
    """A client of the viewer once that has loaded its recording."""
    from rerun.experimental import ViewerClient

    for _ in range(4 * patience):
        if process.poll() is not None:
            errors = process.stderr.read().decode()
            if "Failed to get render context" in errors or "No graphics adapter" in errors:
                pytest.skip("there is neither a GPU nor Mesa's lavapipe to draw with")
            pytest.fail(f"the viewer ended: {errors[-2000:]}")
        with suppress(Exception):  # whatever the client raises while nobody listens yet
            client = ViewerClient.connect(url)
            state = client.get_state()
            if state.views and not state.loading:
                return client
        time.sleep(0.25)
    pytest.fail(f"the viewer did not load the recording within {patience} s")


def save_screenshot(viewer, png, view, patience=6):
    """Saves what a view shows; on a busy machine the viewer misses its own deadline (Rerun 0.41), which is fixed."""
    for _ in range(patience):
        with suppress(TimeoutError):
            viewer.save_screenshot(str(png), view.view_id)
            return
    pytest.fail(f"the viewer did not draw in time, {patience} times")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
