"""The commands of the how-to on environments of others, with the versions that it names.

They need packages that are no dependencies of ours, so they run only where they are asked for: pytest -m nightly. The
workflow nightly.yml installs the packages with the how-to's own lines.
"""

from __future__ import annotations

import csv
import importlib.metadata
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from scripts import ROOT

PAGE = (ROOT / "docs" / "how-to" / "use-pettingzoo-or-gymnasium.md").read_text(encoding="utf-8")
BLOCK = re.search(r"<!-- tests/test_envs_nightly.py .*?-->\n```bash\n(.*?)```", PAGE, re.S)
LINES = BLOCK[1].splitlines() if BLOCK else []
COMMANDS = [line for line in LINES if line.startswith("python ")]
VERSIONS = [word for line in LINES if line.startswith("pip ") for word in line.split() if "==" in word]


def test_the_page_names_ten_environments() -> None:
    assert len({shlex.split(line)[3] for line in COMMANDS}) >= 10
    for line in COMMANDS:
        if found := re.search(r"pettingzoo:examples\.(\w+)", line):
            assert (ROOT / "examples" / f"{found[1]}.py").exists()


@pytest.mark.nightly
@pytest.mark.parametrize("requirement", VERSIONS)
def test_versions(requirement: str) -> None:
    package, _, version = requirement.partition("==")
    assert importlib.metadata.version(package) == version


@pytest.mark.nightly
@pytest.mark.parametrize("line", COMMANDS)
def test_an_environment_of_others(line: str, tmp_path: Path) -> None:
    """A short run, from the command on the page."""
    short = "--total-timesteps 300 --eval-points 2 --eval-episodes 2 --hidden-dim 16".split()
    words = [sys.executable, *shlex.split(line)[1:], *short, "--run-dir", str(tmp_path / "run")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with open(tmp_path / "run" / "evaluations.csv") as file:
        assert len(list(csv.DictReader(file))) == 2
