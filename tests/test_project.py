"""The project's habits: one version, notes for it, extras, what is public."""

import importlib.metadata
import re
import subprocess
import sys
import tomllib

import pytest
from scripts import ROOT

import envs

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def notes(tag):
    return subprocess.run([sys.executable, ROOT / ".ci" / "notes.py", tag], capture_output=True, text=True)


def test_the_version_has_notes_and_stands_in_one_place():
    done = notes(f"v{PROJECT['version']}")
    assert done.returncode == 0 and done.stdout.startswith("###"), done.stderr
    assert importlib.metadata.version("marl-baselines") == PROJECT["version"], "pip install -e . again"
    assert PROJECT["version"] not in (ROOT / "CITATION.cff").read_text()


@pytest.mark.parametrize("tag", ["v0.0.1", "0.2.0", ""])
def test_a_tag_that_is_not_the_version_makes_no_release(tag):
    done = notes(tag)
    assert done.returncode == 1 and "but pyproject.toml says" in done.stderr and not done.stdout


def test_the_page_names_what_envs_has():
    row = next(
        line for line in (ROOT / "docs/how-to/what-is-public.md").read_text().splitlines() if "`envs.__all__`" in line
    )
    assert set(re.findall(r"`(\w+)`", row)) == set(envs.__all__)


def test_what_only_the_benchmark_needs_is_an_extra_of_its_own():
    names = {"pandas", "scipy", "matplotlib"}
    extra = PROJECT["optional-dependencies"]["benchmark"]
    assert {package.partition(">=")[0] for package in extra} == names
    assert not names & {package.partition(">=")[0] for package in PROJECT["dependencies"]}
