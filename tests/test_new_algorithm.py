"""A tenth algorithm, by the steps of CONTRIBUTING.md, in a copy of the scripts, the pages and the tests."""

import re
import shutil
import subprocess
import sys

import pytest
from scripts import ROOT

FILES = ["docs", "algos_families", "algos_maths", "algos_randomness", "algos_runs", "algos_text"]
OF_ALL = ["test_same_name_same_text", "test_one_order_and_the_same_end"]


def tried(folder, files, *words):
    """What the tests of a copy say."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        *(f"tests/test_{file}.py" for file in files),
    ]
    done = subprocess.run([*command, *words], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stdout


@pytest.mark.slow
def test_a_copy_under_another_name_passes_and_what_is_missing_is_named(tmp_path):
    for folder in ("algos", "benchmark", "docs", "examples", "tests"):  # not envs, whose rules would be compiled anew
        unneeded = shutil.ignore_patterns("__pycache__", "results", "teams", "films", "updates")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=unneeded)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, tmp_path)

    script = (ROOT / "algos" / "ippo.py").read_text(encoding="utf-8").replace("ippo", "mine").replace("IPPO", "MINE")
    script = script.replace("ratios.clamp(1 - args.clip_coef, 1 + args.clip_coef)", "ratios.clamp(0.9, 1.1)")
    (tmp_path / "algos" / "mine.py").write_text(script, encoding="utf-8")
    assert "0.9, 1.1" in script  # its update is another one
    code, said = tried(tmp_path, ["algos_text", "algos_runs"], "-k", "mine and (what_comes or learns_the)")
    assert code == 1 and "algos/mine.py has no page; write docs/algorithms/mine.md" in said
    assert re.search(r"SOON in \S+ must say with which flags mine learns a game", said)

    page = (ROOT / "docs" / "algorithms" / "ippo.md").read_text(encoding="utf-8").replace("IPPO", "MINE")
    page = page.replace("update: ratios.clamp", "update: ratios.clamp(0.9")
    (tmp_path / "docs" / "algorithms" / "mine.md").write_text(page, encoding="utf-8")
    with open(tmp_path / "tests" / "test_algos_runs.py", "a", encoding="utf-8") as file:
        file.write('SOON["mine"] = ["--total-timesteps", 30_000]\n')
    code, said = tried(tmp_path, FILES, "-k", " or ".join(["mine", *OF_ALL]))
    assert code == 0, said
    assert int(re.findall(r"(\d+) passed", said)[0]) > 20
