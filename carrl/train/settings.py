"""What a run's folder says of how the run was configured, held in memory in case the folder is deleted."""

from pathlib import Path

from carrl.errors import CarrlError, CheckpointError
from carrl.files import read_whole, write_whole
from carrl.train.files import MAX_CONFIG_BYTES

Settings = dict[Path, bytes]


def read_settings(run: Path) -> Settings:
    """The files in `.hydra`, by path.

    Raises:
        CheckpointError: one of them is a folder, a link or no other regular file, or too large.
    """
    return {
        file: read_whole(file, MAX_CONFIG_BYTES, f"'{file}'", CheckpointError, follow_links=False)
        for file in run.glob(".hydra/*.yaml")
    }


def put_back(settings: Settings) -> None:
    """Writes them anew.

    Raises:
        CarrlError: the disk refuses it.
    """
    for file, content in settings.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CarrlError(f"'{file.parent}' cannot be made: {error.strerror}; choose another place") from error
        write_whole(file, content)
