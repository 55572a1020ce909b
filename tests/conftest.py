"""What several test folders share."""

from pathlib import Path

import pytest

REAL_CIRCUITS = Path(__file__).resolve().parents[1].parent / "shared" / "tracks" / "real"


@pytest.fixture(scope="session")
def real_circuits() -> Path:
    """The folder of real circuits' centrelines, which stands beside the repository where it is present at all."""
    if not REAL_CIRCUITS.is_dir():
        pytest.skip(f"the optional folder of real circuits, {REAL_CIRCUITS}, is absent")
    return REAL_CIRCUITS
