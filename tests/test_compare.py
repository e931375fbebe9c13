"""An algorithm of one's own beside another: the difference, its test, what may be claimed, and the page's way to it."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.stats import ttest_ind
from scripts import ROOT

from benchmark import compare
from benchmark.measures import in_tables
from benchmark.store import RESULTS, load


def test_the_interval_is_that_of_students_t_test():
    mine, other = pd.Series([0.5, 0.9, 0.7, 0.65]), pd.Series([0.3, 0.45, 0.2])
    found = compare.difference(mine, other, 0.05)
    expected = ttest_ind(mine, other).confidence_interval(0.95)
    assert found.value - found.half_width == pytest.approx(expected.low)
    assert found.value + found.half_width == pytest.approx(expected.high)
    assert compare.difference(mine, other, 0.01).half_width > found.half_width


def test_a_single_seed_has_the_others_spread():
    mine = pd.Series([1.0, 2.0, 3.0])
    found = compare.difference(mine, pd.Series([0.0]), 0.05)
    assert found.value == 2.0
    assert found.half_width == pytest.approx(4.302653 * np.sqrt(1 / 3 + 1))  # 2 degrees of freedom, deviation 1
    assert np.isinf(compare.difference(mine[:1], mine[1:2], 0.05).half_width)


@pytest.mark.parametrize(
    "value, half_width, said",
    [
        (
            0.3,
            0.1,
            "You may claim: on a task, with these flags and this budget, mine has a higher average return than ",
        ),
        (0.3, 0.1, "by 0.300 (between 0.200 and 0.400, the 95 % interval)"),
        (
            -0.3,
            0.1,
            "mine has a lower average return than mappo, by 0.300 (between 0.200 and 0.400, the 95 % interval)",
        ),
        (0.3, 0.4, "No difference may be claimed on a task: it lies between -0.100 and +0.700 (the 95 % interval)."),
        (0.3, 0.4, "a true difference of 0.500 is found in 80 % of such experiments"),
        (0.0, 0.0, "No difference may be claimed"),
        (0.3, np.inf, "Nothing may be claimed on a task: one seed each"),
    ],
)
def test_claims(value, half_width, said):
    found = compare.Difference(value, half_width, 0.5)
    assert said in compare.claim(["mine", "mappo"], "a task", found, 0.05)


@pytest.mark.parametrize("level", [0.05, 0.05 / 40])
def test_a_difference_is_found_as_often_as_is_said(level):
    """Over 700 pairs of samples whose means differ by what the deviation 1 lets one find."""
    rng, found, told = np.random.default_rng(0), 0, []
    typical = pd.Series([-1.0, 0.0, 1.0])  # of deviation 1
    detectable = compare.difference(typical, typical, level).detectable
    for _ in range(700):
        mine, other = pd.Series(rng.normal(detectable, 1, 3)), pd.Series(rng.normal(0, 1, 3))
        one = compare.difference(mine, other, level)
        found += abs(one.value) > one.half_width
        told.append(one.detectable / one.half_width)
    assert found / 700 == pytest.approx(compare.POWER, abs=0.03)
    assert np.ptp(told) < 1e-6 and min(told) > 1


def test_two_sides_that_are_the_same_are_not_compared(tmp_path):
    """A copy in which nothing was changed, or a value that PAPER overrides."""
    source = RESULTS / "lbf-15x15-3p-5f" / "ippo-shared"
    for name in ("ippo", "mine"):
        target = tmp_path / "lbf-15x15-3p-5f" / f"{name}-shared.json"
        target.parent.mkdir(exist_ok=True)
        text = source.with_suffix(".json").read_text()
        target.write_text(text.replace('"algorithm": "ippo"', f'"algorithm": "{name}"'))
        target.with_suffix(".csv").write_text(source.with_suffix(".csv").read_text())
    [said] = re.findall(r"(?m)^\* (.*)", compare.Comparison(["mine", "ippo"], [tmp_path]).page())
    assert said.startswith(
        "Nothing is compared on lbf-15x15-3p-5f, with parameter sharing: mine and ippo have the same"
    )
    assert "has no effect" in said


@pytest.mark.slow
def test_seeds_of_two_algorithms_hardly_rise_and_fall_together():
    """Outside the matrix games. So they are compared as samples, not as pairs."""
    evaluations = in_tables(load(RESULTS))
    evaluations = evaluations[evaluations["family"] != "matrix"]
    found = []
    for _, rows in evaluations.groupby(["task", "sharing", "total_timesteps"]):
        averages = rows.pivot_table(index="seed", columns="algorithm", values="return_mean")
        correlations = averages.corr(min_periods=3).to_numpy()
        found += list(correlations[np.triu_indices(len(correlations), 1)])
    known = pd.Series(found).dropna()
    assert len(known) >= 30 and abs(known.mean()) < 0.25, known.describe()


@pytest.mark.slow
def test_five_percent_are_shared_by_all_comparisons_of_a_page():
    comparison = compare.Comparison(["qmix", "vdn"], [RESULTS])
    assert len(comparison.groups) > 10
    assert comparison.level == 0.05 / len(comparison.groups)
    assert len(re.findall(r"(?m)^\* ", comparison.page())) == len(comparison.groups)


def in_one_sentence(monkeypatch, capsys, *words):
    monkeypatch.setattr(sys, "argv", ["compare.py", *words])
    with pytest.raises(SystemExit, match="2"):
        compare.main()
    return capsys.readouterr().err


@pytest.mark.slow
def test_wrong_input_ends_in_one_sentence(monkeypatch, capsys, tmp_path):
    output = ["--output", str(tmp_path / "out")]
    said = in_one_sentence(monkeypatch, capsys, "mine", "mappo", *output)
    assert "compare: there are no results of mine; there are some of coma, ia2c, " in said
    said = in_one_sentence(monkeypatch, capsys, "mappo", "iql", *output)  # on- and off-policy: other budgets
    assert said.endswith("compare: mappo and iql have no task, sharing, changed flags and budget in common.\n")
    said = in_one_sentence(monkeypatch, capsys, "mine", "mappo", "--results", str(tmp_path), *output)
    assert "there are no results in" in said and not (tmp_path / "out").exists()


def pages_way(tmp_path):
    """Copies the repository, so that commands run there; what the page says of small and of large comparisons."""
    for folder in ("algos", "benchmark"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("results", "teams", "figures"))
    return (ROOT / "docs/how-to/compare-mine.md").read_text().split("## At the paper's size")


@pytest.mark.nightly
def test_the_pages_way(tmp_path):
    """The page's trainings and what may be claimed, in its second comparison with a tenth of the steps."""
    small, _ = pages_way(tmp_path)
    claims = "You may claim: on matrix-climbing,", "No difference may be claimed on lbf-5x5-2p-1f,"
    for part, expected in zip(small.split("## A difference that may")[1:], claims):
        copy, train, show = commands(part)
        run(tmp_path, copy)
        [diff] = re.findall(r"```diff\n(.*?)```", part, flags=re.DOTALL)
        removed, added = ("".join(re.findall(rf"(?m)^{re.escape(sign)}(.*\n)", diff)) for sign in "-+")
        mine = tmp_path / copy[-1]
        assert mine.read_text().count(removed) == 1
        mine.write_text(mine.read_text().replace(removed, added))
        run(tmp_path, [word.replace("100000", "10000") for word in train])  # which only the second has
        said = run(tmp_path, show)
        page = (tmp_path / show[-1] / "comparison.md").read_text()
        assert said == page + "\n" and f"\n* {expected}" in page
        assert page.count("| 3 | ") == 2
        with Image.open(tmp_path / show[-1] / "curves.png") as image:
            assert image.width > 500


@pytest.mark.slow
def test_the_pages_way_at_the_papers_size(tmp_path):
    """With the committed results in the place of runs of hours."""
    _, large = pages_way(tmp_path)
    _, train, show = commands(large)  # the first is a dry run
    (task,) = {word for words in (train, show) for word in words if word.startswith("lbf-")}
    settings = RESULTS / task / "vdn-shared.json"  # in the place of mine's runs of hours
    for file in (settings, settings.with_suffix(".csv")):
        target = tmp_path / "paper-results" / task / file.name.replace("vdn", "mine")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(file.read_text().replace('"algorithm": "vdn"', '"algorithm": "mine"'))
    run(tmp_path, [word.replace("benchmark/results", str(RESULTS)) for word in show])
    page = (tmp_path / "paper-comparison/comparison.md").read_text()
    assert f"| {task}, with parameter sharing | iql | " in page


def commands(text: str) -> list[list[str]]:
    """The commands of a page's blocks."""
    found = "".join(re.findall(r"```bash\n(.*?)```", text, flags=re.DOTALL)).replace("\\\n", "")
    return [shlex.split(line) for line in found.splitlines()]


def run(folder: Path, words: list[str]) -> str:
    """What a command says that must succeed."""
    words = [sys.executable if word == "python" else word for word in words]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
