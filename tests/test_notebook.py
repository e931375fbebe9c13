"""The notebook docs/first-steps.ipynb is that of the pages, and it trains, plots and shows films."""

import re
import shutil
import sys
from types import SimpleNamespace
from typing import Any

import nbclient
import nbformat
import pytest
from scripts import ROOT

sys.path.insert(0, str(ROOT / "docs" / "extensions"))

from notebook_of_pages import FILE, PREPARE, name_repository, notebook, to_markdown


def test_the_committed_notebook_is_that_of_the_pages():
    assert FILE.read_text(encoding="utf-8") == notebook("")  # python docs/extensions/notebook_of_pages.py


def test_links_begin_at_docs_or_at_the_repository():
    text = "{term}`one\n  two <three>`, [a](../b.md#c), [d](e.md), [f](https://g.h)"
    assert to_markdown(text, "how-to/x.md", "") == "one\n  two, [a](b.md#c), [d](how-to/e.md), [f](https://g.h)"
    assert "[a](https://x.y/z/blob/main/docs/b.md#c)" in to_markdown(text, "how-to/x.md", "https://x.y/z")


def test_the_sites_copy_knows_the_repository(tmp_path):
    copy = tmp_path / "_downloads" / "0123" / FILE.name
    copy.parent.mkdir(parents=True)
    copy.touch()
    app: Any = SimpleNamespace(outdir=tmp_path, config=SimpleNamespace(repository="https://x.y/z"))
    name_repository(app, None)
    assert 'REPOSITORY_URL = \\"https://x.y/z\\"' in copy.read_text(encoding="utf-8")


@pytest.fixture
def execute(tmp_path, monkeypatch):
    """execute(text, folder): a notebook, with the outputs of its cells."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))

    def here(text, folder):
        made = nbformat.reads(text, as_version=4)
        client = nbclient.NotebookClient(made, timeout=600, resources={"metadata": {"path": str(folder)}})
        return client.execute()

    return here


@pytest.mark.slow
def test_the_notebook_trains_plots_and_shows_films(execute, tmp_path):
    """In a copy of what it needs, so that no run is left in this repository; and a class has solved its task."""
    for part in ("algos", "examples", "tests/data/updates", "benchmark/teams/lbf-15x15-3p-5f"):
        shutil.copytree(ROOT / part, tmp_path / part)
    (tmp_path / "docs").mkdir()
    text = FILE.read_text(encoding="utf-8")
    for name in ("values", "next_values"):
        assert text.count(f" {name} = {name}\\") == 1
        text = text.replace(f" {name} = {name}\\", f" {name} = {name}.sum(-1, keepdim=True)\\")
    cells = execute(text, tmp_path / "docs").cells
    outputs = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [kind for output in outputs for kind in output.get("data", ()) if kind.startswith("image/")]
    assert shown == ["image/gif", "image/gif", "image/png"]
    climbing, checked = ("".join(output.get("text", "") for output in cells[k].outputs) for k in (-4, -2))
    assert "mine.py: collect is right, 5 updates in 4 cases are those of EPyMARL's VDN" in checked
    assert re.findall("return_mean ([0-9.]+)", climbing)[-1] in ("125.000", "150.000")
    assert sum(len(output.get("text", "").splitlines()) for output in outputs) < 60
    returns = [
        float(line.split("return_mean ")[1].split(",")[0])
        for output in outputs
        for line in output.get("text", "").splitlines()
        if re.match(r"step .*return_mean [01]\.", line)  # and not of the climbing game
    ]
    assert returns[0] < 0.5 and returns[-1] > 0.9


@pytest.mark.slow
def test_outside_a_clone_it_makes_one(execute, tmp_path):
    """As in Colab, where nothing is there. The installation is left out: it would change where this test runs."""
    for address in (str(ROOT), ""):
        prepare = PREPARE.format(address=address).replace("%pip install", "!echo")
        text = nbformat.writes(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(prepare)]))
        folder = tmp_path / f"empty{len(address)}"
        folder.mkdir()
        if address:
            [*_, said] = execute(text, folder).cells[0].outputs
            assert "--quiet -e .[benchmark]" in said.text and (folder / "marl-baselines/algos/mappo.py").exists()
        else:
            with pytest.raises(nbclient.exceptions.CellExecutionError, match="Write the address of the repository"):
                execute(text, folder)
