"""When a value agrees with the paper's: the level of the test, what is counted, the placebo, the paper's opponents."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t, ttest_ind

from benchmark import agreement, measures, report, store, tables


@pytest.mark.parametrize("seeds", [1, 2, 3, 5])
def test_false_alarms_keep_the_level(seeds):
    """Also where rounding matters: the paper's intervals are printed with two decimals."""
    assert agreement.false_alarms(seeds, 1.0) == pytest.approx(agreement.LEVEL, abs=0.006)
    assert all(agreement.false_alarms(seeds, interval) < 0.065 for interval in (0.002, 0.005, 0.01, 0.02, 0.05))


def test_one_seed_has_the_papers_spread():
    """The paper's interval of 0.4 is 2 s / sqrt(5)."""
    expected = t.ppf(0.975, 4) * (0.4 * np.sqrt(5) / 2) * np.sqrt(1 + 1 / 5)
    assert agreement.half_width(np.nan, 1, 0.4) == pytest.approx(expected)
    assert agreement.half_width(np.nan, 1, 0.0) == agreement.half_width(np.nan, 1, 0.005)


@pytest.mark.parametrize("seeds", [2, 3, 5, 8])
def test_several_seeds_make_it_students_test(seeds):
    rng = np.random.default_rng(seeds)
    for shift in np.linspace(0, 3, 30):
        ours, theirs = rng.normal(shift, 1, seeds), rng.normal(0, 1, 5)
        intervals = [2 * each.std(ddof=1) / np.sqrt(len(each)) for each in (ours, theirs)]
        inside = abs(ours.mean() - theirs.mean()) <= agreement.half_width(intervals[0], seeds, intervals[1])
        assert inside == (ttest_ind(ours, theirs).pvalue >= 0.05)


def cells(*rows):
    """Compared cells: (task, algorithm, metric, mean, interval, seeds, the paper's mean and interval)."""
    names = ["task", "algorithm", "metric", "mean", "interval", "seeds", "paper_mean", "paper_interval"]
    made = pd.DataFrame(rows, columns=names).assign(
        sharing="shared", paper_task=lambda each: each["task"].map(store.paper_task)
    )
    width = agreement.half_width(made["interval"], made["seeds"], made["paper_interval"])
    return made.assign(difference=(made["mean"] - made["paper_mean"]) / width)


def test_what_is_counted():
    """Not where nothing varies, and not win rates; those that are set apart are named."""
    rows = [
        ("matrix-penalty-0", "ia2c", "max_return", 250.0, 0.0, 5, 250.0, 0.0),
        ("matrix-penalty-0", "ia2c", "average_return", 248.0, 0.1, 5, 248.1, 0.2),
        ("lbf-8x8-2p-2f-c", "maddpg", "average_return", 0.83, np.nan, 1, 0.32, 0.02),
        ("smaclite-3s5z-sc2", "maa2c", "average_return", 19.0, np.nan, 1, 19.0, 0.5),
        ("smaclite-3s5z-sc2", "maa2c", "max_win_rate", 1.0, np.nan, 1, 1.0, 0.5),
        ("mpe-spread", "maddpg", "average_return", -150.0, np.nan, 1, -150.0, 2.0),
    ]
    counted = agreement.counted(cells(*rows))
    assert list(counted["apart"]) == ["", "MADDPG in LBF", "the stand-ins of SMAC", ""]
    assert list(counted["agrees"]) == [True, False, True, True]
    assert set(counted["metric"]) == {"average_return"}


def test_the_placebo_is_another_algorithms_value():
    """Of three algorithms, the paper has 0, 1 and 50 +- 1: only the first two pass for each other."""
    rows = [
        ("mpe-spread", name, "max_return", value, np.nan, 1, value, 1.0)
        for name, value in {"ia2c": 0.0, "ippo": 1.0, "coma": 50.0}.items()
    ]
    pretended = agreement.placebo(agreement.counted(cells(*rows)))
    assert len(pretended) == 6 and pretended["agrees"].sum() == 2
    assert set(pretended.loc[pretended["agrees"], "algorithm"]) == {"ia2c", "ippo"}


def test_the_bias_of_a_maximum_of_one_seed():
    """41 equal points with the noise of 100 episodes: the best of them is 2.2 standard errors above, and a mean of five
    seeds' 2.2 / sqrt(5)."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(20):
        curve = pd.DataFrame({"point": range(41), "return_mean": rng.normal(0, 0.1, 41), "return_std": 1.0})
        found.append(agreement.maximum_bias(curve))
    highest = np.random.default_rng(0).normal(0, 0.1, (10000, 41)).max(axis=1).mean()
    assert np.mean(found) == pytest.approx(highest * (1 - 1 / np.sqrt(5)), rel=0.25)
    still = pd.DataFrame({"point": range(41), "return_mean": np.linspace(0, 1, 41), "return_std": 0.0})
    assert agreement.maximum_bias(still) == 0


# ---------------------------------------------------------------------------------------------------- opponents


def write_runs(folder, task, algorithm, changed, returns):
    """A table of one seed, as collect.py leaves it."""
    path = store.table_path(folder, algorithm, task, "shared", changed)
    path.parent.mkdir(parents=True, exist_ok=True)
    names = "seed,point,timestep,wall_seconds,cpu_seconds,return_mean,return_std,episode_length"
    lines = [f"0,{point},{point * 1000},1,3600,{value},0.5,25.0" for point, value in enumerate(returns)]
    path.with_name(f"{path.name}.csv").write_text("\n".join([names, *lines]) + "\n")
    budget = (len(returns) - 1) * 1000
    settings = {"algorithm": algorithm, "changed": changed, "paper_timesteps": budget, "seeds": {"0": {"commit": None}}}
    settings["flags"] = {"env": task, "total_timesteps": budget, "parameter_sharing": True}
    path.with_name(f"{path.name}.json").write_text(json.dumps(settings))


PAPERS = measures.paper_setting("mpe-tag")
ANOTHER = {"env_kwargs": "opponent='0123456789abcdef'"}


def test_the_papers_rows_are_of_runs_against_its_own_opponents(tmp_path):
    assert list(PAPERS) == ["env_kwargs"] and len(store.PAPER_OPPONENTS["mpe-tag"]) == 16
    for changed, returns in (({}, [0.0, 30.0]), (PAPERS, [0.0, 17.0]), (ANOTHER, [0.0, 99.0])):
        write_runs(tmp_path, "mpe-tag", "ia2c", changed, returns)
    made = report.Report(tmp_path)
    [compared] = made.compared[made.compared["metric"] == "max_return"].itertuples()
    assert compared._asdict()["mean"] == 17 and compared.paper_mean == 17.44
    own = measures.our_cells(made.evaluations, own_opponent=True)
    assert list(own.loc[own["metric"] == "max_return", "mean"]) == [30]
    text = made.long()
    above, _, below = text.partition("## Against our own opponents")
    assert "17.00" in above and "30.00" not in above
    table = below[: below.index("### Other flags and budgets")]
    assert "30.00" in table and "| paper |" not in table and "17.44" not in table and "difference" not in table
    assert "99.00" in text.partition("### Other flags and budgets")[2]
    assert set(made.normalised["return_mean"]) == {0, 17}
    verdicts = {claim.sentence: ours.figures for claim, _, ours in made.verdicts()}
    assert not any("30.00" in figures for figures in verdicts.values())


def test_without_such_runs_the_papers_rows_are_compared_with_nothing(tmp_path):
    for name in ("ia2c", "mappo"):
        write_runs(tmp_path, "mpe-adversary", name, {}, [0.0, 12.0])
        write_runs(tmp_path, "mpe-spread", name, {}, [-200.0, -133.0])
    made = report.Report(tmp_path)
    assert set(made.compared["task"]) == {"mpe-spread"} and len(made.counted) == 4
    assert "| mpe-adversary | ours |" not in made.long().partition("## Against our own opponents")[0]
    assert "**12.00** ¹" in made.long()


def test_a_shorter_run_against_the_papers_opponent_is_of_another_budget(tmp_path):
    shorter = PAPERS | {"total_timesteps": 1000}
    write_runs(tmp_path, "mpe-tag", "ia2c", shorter, [0.0, 17.0])
    both = tables.compare(measures.our_cells(store.load(tmp_path)), store.paper_cells())
    assert both["other_budget"].all() and both["difference"].isna().all() and (both["paper_task"] == "mpe-tag").all()


def test_the_report_says_what_agrees():
    made = report.Report(store.RESULTS)
    said, table = made.agreement(), made.agreement_table()
    others = made.counted[(made.counted["family"] != "matrix") & (made.counted["apart"] == "")]
    averages = others[others["metric"] == "average_return"]
    assert f"{averages['agrees'].sum()} of {len(averages)} average returns" in said
    lines = [line.split(" | ") for line in table.splitlines() if line.startswith("| ")]
    [lbf] = [line for line in lines if line[0] == "| LBF, with parameter sharing"]
    counted = made.counted[made.counted["family"] == "lbf"]
    for column, metric in ((1, "average_return"), (3, "max_return")):
        agrees = counted.loc[counted["metric"] == metric, "agrees"]
        assert lbf[column] == f"{agrees.sum()} of {len(agrees)}"
    assert "cells in which both intervals are printed as 0.00" in table


def test_the_readme_counts_averages_by_family_and_by_seeds():
    made = report.Report(store.RESULTS)
    table, sentence = made.agreement_in_short()
    averages = made.counted[made.counted["metric"] == "average_return"]
    header, _, ours, others = ([cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines())
    chosen = averages[averages["family"] == "rware"]
    column = header.index("RWARE")
    assert ours[column] == f"{chosen['agrees'].sum()} of {len(chosen)}"
    assert others[column] == agreement.percent(agreement.placebo(chosen)["agrees"])
    single = averages[(averages["family"] != "matrix") & (averages["seeds"] == 1)]
    assert f" 1: {single['agrees'].sum()} of {len(single)};" in sentence
