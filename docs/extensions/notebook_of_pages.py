"""The notebook docs/first-steps.ipynb, made of sections of pages.

    python docs/extensions/notebook_of_pages.py

writes the file that is committed. It does not know where the repository is. The site's copy does, if conf.py does.
"""

import json
import os
import re
from pathlib import Path

import nbformat
from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
FILE = DOCS / "first-steps.ipynb"
SECTIONS = [
    ("marl.md", "The problem"),
    ("marl.md", "Why learning alone is not enough"),
    ("how-to/first-steps.md", "Train one"),
    ("how-to/first-steps.md", "The curve in Python"),
]
BUDGET = "--total-timesteps 400000", "--total-timesteps 200000 --eval-points 11"  # on the page; in the notebook
HEAD = """\
# First steps

Made of the pages [MARL in ten minutes](marl.md) and [First steps](how-to/first-steps.md).

The next cell prepares the rest. If this notebook is not in a clone of the repository, as in Colab, it makes one and
installs it. If `REPOSITORY_URL` is empty there, write the repository's address between the quotation marks first."""
PREPARE = """\
import os
import sys

REPOSITORY_URL = "{address}"  # where to clone it from, if this notebook is not in a clone
os.environ["PATH"] = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]  # `python` is this one
if os.path.exists("../algos"):
    os.chdir("..")
elif not os.path.exists("algos"):
    assert REPOSITORY_URL, "Write the address of the repository into this cell."
    !git clone {{REPOSITORY_URL}} marl-baselines
    %cd marl-baselines
    %pip install --quiet -e '.[benchmark]'"""
# What a class does itself: texts and code in turn.
CLASS = [
    """\
## Your turn

**Predict.** In the climbing game two agents choose a row and a column of this table at the same time, and both earn the
entry:

| | 0 | 1 | 2 |
|---|---|---|---|
| **0** | 11 | -30 | 0 |
| **1** | -30 | 7 | 0 |
| **2** | 0 | 6 | 5 |

Two agents that do not know each other's plans begin to try actions. At which entry will they end? Write your answer
down before you run the next cell. An episode has 25 steps: divide the return by 25.""",
    "!python algos/iql.py --env matrix-climbing --total-timesteps 20000 --eval-points 3 2>&1 | cat",
    """\
**Edit one line, and a second one like it.** In IQL the value of each agent is trained towards the reward of the team.
In VDN the sum of the agents' values is. The next cell writes a copy of IQL with two more lines, which do nothing yet.
Make each of them sum over the agents, which are the last axis, and keep this axis. The cell's last line holds your file
against updates that were recorded with the paper's own code. If you are stuck, add `--hint 1` or `--hint 2` to it.""",
    """\
from pathlib import Path

FIRST = "    values = values"  # [time, env, agent]
SECOND = "        next_values = next_values"  # [time, env, agent]

lines = Path("algos/iql.py").read_text(encoding="utf-8").splitlines()
for above, line in ("    values = q_values", FIRST), ("        next_values = double_q_values", SECOND):
    [place] = [i for i, text in enumerate(lines) if text.startswith(above)]
    lines.insert(place + 1, line)
Path("mine.py").write_text("\\n".join(lines) + "\\n", encoding="utf-8")
!python examples/check_exercise.py vdn mine.py""",
    """\
**Explain.** Why does no agent need the others' values in play? The [exercises](exercises/index.md) go on from here, and
[Credit](credit.md) shows what a sum of values cannot say.""",
]
FILM = 'from IPython.display import Image\n\nImage(filename="{run}/film.gif")'


def section(page: str, heading: str) -> str:
    """A section of a page of docs/, with its heading."""
    parts = re.split(r"(?m)^(?=## )", (DOCS / page).read_text(encoding="utf-8"))
    [found] = [part for part in parts if part.startswith(f"## {heading}\n")]
    return found


def to_markdown(text: str, page: str, address: str) -> str:
    """A page's text without what only Sphinx knows; its links begin at docs/, or at the repository's address."""

    def link(found: re.Match) -> str:
        target = os.path.normpath((Path(page).parent / found[1]).as_posix())
        return f"]({address}/blob/main/docs/{target})" if address else f"]({target})"

    text = re.sub(r"\{term\}`([^`<]+?)(\s*<[^`]+>)?`", r"\1", text)
    return re.sub(r"\]\((?!https?:|#)([^)]+)\)", link, text).strip()


def commands(block: str) -> list[str]:
    """The code cells of a shell's command; of one that makes a film, also one that shows it."""
    cells = [f"!{block.strip().replace(*BUDGET)} 2>&1 | cat"]  # without the bar that shows how far it is
    if watched := re.search(r"--watch (\S+)", block):
        cells.append(FILM.format(run=watched[1]))
    return cells


def code(language: str, block: str) -> list[str]:
    """The code cells that a page's block becomes."""
    if language == "bash":
        return commands(block)
    if language.startswith("{film}"):  # on the page a picture, here the task's team plays
        team = f"benchmark/teams/{language.split()[1]}"
        algorithm = json.loads((DOCS.parent / team / "config.json").read_text(encoding="utf-8"))["algorithm"]
        return commands(f"python algos/{algorithm}.py --watch {team}")
    return [block.strip()]


def notebook(address: str) -> str:
    """The notebook as the text of its file. address: the repository's, or empty where nobody knows it."""
    cells = [
        nbformat.v4.new_markdown_cell(to_markdown(HEAD, ".", address)),
        nbformat.v4.new_code_cell(PREPARE.format(address=address)),
    ]
    for page, heading in SECTIONS:
        # text, the block's language, the block; text, ...
        parts = re.split(r"(?ms)^```([^\n]+)\n(.*?)^```$", section(page, heading))
        for text, language, block in zip(parts[::3], [*parts[1::3], ""], [*parts[2::3], ""]):
            cells += [nbformat.v4.new_markdown_cell(to_markdown(text, page, address))] if text.strip() else []
            cells += [nbformat.v4.new_code_cell(cell) for cell in code(language, block)] if language else []
    for number, text in enumerate(CLASS):
        if number % 2:
            cells.append(nbformat.v4.new_code_cell(text))
        else:
            cells.append(nbformat.v4.new_markdown_cell(to_markdown(text, ".", address)))
    for number, cell in enumerate(cells):
        cell.id = f"cell-{number}"
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return nbformat.writes(nbformat.v4.new_notebook(cells=cells, metadata=kernel)) + "\n"


def name_repository(app: Sphinx, exception: Exception | None) -> None:
    """Puts the notebook with the repository's address in the place of the committed one, in the built site."""
    for file in Path(app.outdir).glob(f"_downloads/*/{FILE.name}"):
        file.write_text(notebook(app.config.repository), encoding="utf-8")


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("build-finished", name_repository)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    FILE.write_text(notebook(""), encoding="utf-8")
