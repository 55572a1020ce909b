"""What several test folders share."""

from pathlib import Path

import pytest

from tests.driven_episode import pedals  # noqa: F401 (a fixture)
from tests.small_episode import among_others, scene, trace, track_shape  # noqa: F401 (fixtures)

REAL_CIRCUITS = Path(__file__).resolve().parents[2] / "shared" / "tracks" / "real"


def pytest_collection_modifyitems(items):
    """Puts files with slow tests first, so that no core begins one of them when the others are nearly done."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def real_circuits() -> Path:
    """The folder of real circuits' centrelines, which stands beside the repository where it is present at all."""
    if not REAL_CIRCUITS.is_dir():
        pytest.skip("the optional folder ../shared/tracks/real of real circuits is absent")
    return REAL_CIRCUITS


@pytest.fixture
def marker(tmp_path):
    """A file that must not be there when a test ends: what a payload would make."""
    yield tmp_path / "harmed"
    assert not (tmp_path / "harmed").exists()


@pytest.fixture(autouse=True, scope="session")
def _no_columns():
    """No width is asked for, whoever starts the tests.

    GNU readline, which pytest imports, exports COLUMNS and LINES; pytest-xdist's processes inherit them
    (findings/readline_exports_columns_to_workers.sh).
    """
    patches = pytest.MonkeyPatch()
    patches.delenv("COLUMNS", raising=False)
    patches.delenv("LINES", raising=False)
    yield
    patches.undo()


@pytest.fixture(autouse=True, scope="session")
def _one_composition():
    """Hydra 1.3 composes the whole configuration once more to find out `hydra.mode`, which no test sets.

    What it says where that is not set is said at once: a quarter of the time of the smallest trainings.
    """
    patches = pytest.MonkeyPatch()
    patches.setattr("hydra._internal.hydra.Hydra.get_mode", lambda *_, **__: None)
    yield
    patches.undo()
