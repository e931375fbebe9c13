"""The project's habits: one version, notes for it, extras, what is public, and what imports what in benchmark/."""

import ast
import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from scripts import ROOT

import benchmark
import envs
from envs import needed
from envs.runs.origin import project_version

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def notes(tag):
    return subprocess.run([sys.executable, ROOT / ".ci" / "notes.py", tag], capture_output=True, text=True)


def test_the_version_has_notes_and_stands_in_one_place():
    done = notes(f"v{PROJECT['version']}")
    assert done.returncode == 0 and done.stdout.startswith("###"), done.stderr
    assert project_version() == PROJECT["version"]
    assert PROJECT["version"] not in (ROOT / "CITATION.cff").read_text()


@pytest.mark.parametrize("tag", ["v0.0.1", "0.2.0", ""])
def test_a_tag_that_is_not_the_version_makes_no_release(tag):
    done = notes(tag)
    assert done.returncode == 1 and "but pyproject.toml says" in done.stderr and not done.stdout


def test_without_the_packages_a_program_says_what_to_type(tmp_path):
    """With -S Python finds nothing that was installed."""
    benchmark = [[f"benchmark/{name}.py"] for name in PROGRAMS]
    for words in (["algos/mappo.py"], ["algos/iql.py", "--help"], ["-m", "envs"], *benchmark, ["-m", "benchmark.run"]):
        done = subprocess.run([sys.executable, "-S", *words], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 2 and done.stderr.count("\n") == 1 and not done.stdout
        said = f"these packages are missing: {', '.join(needed.PACKAGES)}; python -m pip install -e"
        assert done.stderr.startswith(f"{words[-1] if words[0] == '-m' else Path(words[0]).stem}: {said}")
    names = [package.partition(">=")[0] for package in PROJECT["dependencies"]]
    assert [{"PIL": "pillow"}.get(package, package) for package in needed.PACKAGES] == names


@pytest.mark.slow
def test_a_script_needs_no_installation(tmp_path):
    """From any folder; with -S the packages are found, but not what an installation of this project has left."""
    variables = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if "site-packages" in path)}
    flags = "--env matrix-climbing --total-timesteps 250 --eval-points 1 --run-dir run".split()
    command = [sys.executable, "-S", str(ROOT / "algos" / "mappo.py"), *flags]
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "config.json").read_text())["version"] == PROJECT["version"]


def test_programs_that_tests_start_import_this_checkout(tmp_path):
    """Whatever is installed, and wherever they are started."""
    program = "import benchmark, envs; print(benchmark.__file__, envs.__file__, sep='\\n')"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.split("\n")[:2] == [str(ROOT / folder / "__init__.py") for folder in ("benchmark", "envs")]


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


@pytest.mark.parametrize("package", ["matplotlib", "pandas", "scipy"])
def test_a_program_of_the_benchmark_says_which_extra_it_needs(monkeypatch, capsys, package):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(sys, "argv", ["benchmark/report.py"])
    with pytest.raises(SystemExit, match="2"):
        importlib.reload(benchmark)
    assert capsys.readouterr().err == f"report: {package} is not installed; pip install -e '.[benchmark]' does it.\n"


@pytest.mark.slow
@pytest.mark.parametrize("program", ["run", "collect", "report", "compare", "time_stepping", "time_training"])
def test_programs_of_the_benchmark_begin_in_any_folder_and_as_modules(program, tmp_path):
    for command, folder in (([ROOT / "benchmark" / f"{program}.py"], tmp_path), (["-m", f"benchmark.{program}"], ROOT)):
        done = subprocess.run([sys.executable, *command, "--help"], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0 and done.stdout.startswith("usage:"), done.stderr


FLOORS = [
    {"hyperparameters"},
    {"store"},
    {"plan", "measures", "agreement"},
    {"campaign", "tables"},
    {"cluster", "plots", "claims"},
]
PROGRAMS = {"run", "collect", "report", "compare", "time_stepping", "time_training"}


def test_arrows_between_modules_of_the_benchmark_point_down():
    below: set[str] = set()
    for floor in [*FLOORS, PROGRAMS]:
        for name in floor:
            imported = set()
            for node in ast.walk(ast.parse((ROOT / "benchmark" / f"{name}.py").read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module == "benchmark":
                    imported |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("benchmark."):
                    imported.add(node.module.removeprefix("benchmark."))
            assert imported <= below, f"{name} imports {imported - below}"
        below |= floor
    assert below | {"__init__"} == {path.stem for path in (ROOT / "benchmark").glob("*.py")}
