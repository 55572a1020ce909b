"""The notebooks in examples/ run from their first cell to their last, and show what they show as they are kept."""

from pathlib import Path

import nbformat
import pytest

nbclient = pytest.importorskip("nbclient", reason="pip install nbclient ipykernel")
NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.ipynb"))


def kinds(notebook):
    """What each cell of code puts out, texts and pictures, but for warnings."""
    return [
        [sorted(output.get("data", ["text"])) for output in cell.outputs if output.get("name") != "stderr"]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs_and_shows_what_it_is_kept_with(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(path.parents[1]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    kept = nbformat.read(path, as_version=4)
    fresh = nbformat.read(path, as_version=4)
    for cell in fresh.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    nbclient.NotebookClient(fresh, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert kinds(fresh) == kinds(kept)
    assert any("image/png" in kind for cell in kinds(fresh) for kind in cell)


def test_both_notebooks_are_there():
    assert [path.name for path in NOTEBOOKS] == ["inspect_a_log.ipynb", "quick_start.ipynb"]
