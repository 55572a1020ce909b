"""What several test folders share."""

import copy
import gc
import sys
from pathlib import Path

import pytest
from hydra._internal.core_plugins.file_config_source import FileConfigSource

from carrl.config import config_dir
from carrl.files import write_whole
from tests.driven_episode import pedals  # noqa: F401 (a fixture)
from tests.small_episode import among_others, scene, trace, track_shape  # noqa: F401 (fixtures)

REAL_CIRCUITS = Path(__file__).resolve().parents[2] / "shared" / "tracks" / "real"


def pytest_collection_modifyitems(items):
    """Puts files with slow tests first, so that no core begins one of them when the others are nearly done."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish():
    """Half a million objects of modules and tests stay until the end; to look them through takes 0.3 s each time."""
    gc.freeze()


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


@pytest.fixture(autouse=True, scope="session")
def _configurations_read_once():
    """Hydra reads the same two dozen files of conf/ for every command, which takes a third of a refusal's time."""
    read, known = FileConfigSource.load_config, {}

    def load_config(source, config_path):
        if Path(source.path.removeprefix("file://")) != config_dir():
            return read(source, config_path)
        if config_path not in known:
            known[config_path] = read(source, config_path)
        return copy.deepcopy(known[config_path])

    patches = pytest.MonkeyPatch()
    patches.setattr(FileConfigSource, "load_config", load_config)
    yield
    patches.undo()


@pytest.fixture(autouse=True, scope="module")
def blank_learning_curves():
    """Computes no pixel of trainings' learning curves, which takes half the time of the smallest trainings.

    All that is on them is drawn on a figure all the same. A module that looks at them has a fixture of this name.
    """
    experiment = sys.modules.get("carrl.train.experiment")  # which takes long to import, so not from here
    if experiment is None:
        yield
        return
    drawn = experiment._draw_learning_curve

    def draw_blank(run):
        with pytest.MonkeyPatch.context() as within:
            within.setattr("carrl.render.curves.save_figure", lambda figure, path: write_whole(path, b"blank"))
            drawn(run)

    with pytest.MonkeyPatch.context() as patches:
        patches.setattr(experiment, "_draw_learning_curve", draw_blank)
        yield
