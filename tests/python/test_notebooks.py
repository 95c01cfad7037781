"""The notebooks run from the first cell to the last; what they find is asserted in them."""

import importlib.util
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).resolve().parents[2] / "examples" / "notebooks"


def test_notebooks_are_kept_without_outputs() -> None:
    paths = sorted(NOTEBOOKS.glob("*.ipynb"))
    assert len(paths) == 2
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert '"outputs": []' in text and "image/png" not in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("nbclient", "ipykernel")),
    reason="nbclient and ipykernel are not installed",
)
@pytest.mark.parametrize("name", ["hidden_effect", "gradients"])
def test_notebook_runs(name: str) -> None:
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    NotebookClient(book, timeout=300, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()
    told = [output for cell in book.cells for output in cell.get("outputs", [])]
    kinds = {kind for output in told for kind in output.get("data", {})}
    assert "image/png" in kinds and "text/plain" in kinds
