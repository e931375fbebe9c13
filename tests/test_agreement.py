"""When a value agrees with the paper's: the level of the test, what is counted, the placebo, the paper's opponents."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t, ttest_ind

import envs
from benchmark import agreement, measures, report, store, tables


@pytest.fixture(scope="module")
def committed():
    return report.Report(store.RESULTS)


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
        ("smaclite-3s5z-sc2-v2", "maa2c", "average_return", 19.0, np.nan, 1, 19.0, 0.5),
        ("smaclite-3s5z-sc2-v2", "maa2c", "max_win_rate", 1.0, np.nan, 1, 1.0, 0.5),
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_without_such_runs_the_papers_rows_are_compared_with_nothing(tmp_path):
    for name in ("ia2c", "mappo"):
        write_runs(tmp_path, "mpe-adversary", name, {}, [0.0, 12.0])
        write_runs(tmp_path, "mpe-spread", name, {}, [-200.0, -133.0])
    made = report.Report(tmp_path)
    assert set(made.compared["task"]) == {"mpe-spread"} and len(made.counted) == 4
    text = made.long()
    assert "| mpe-adversary | ours |" not in text.partition("## Against our own opponents")[0] and "12.00 ¹" in text


def test_a_shorter_run_against_the_papers_opponent_is_of_another_budget(tmp_path):
    shorter = PAPERS | {"total_timesteps": 1000}
    write_runs(tmp_path, "mpe-tag", "ia2c", shorter, [0.0, 17.0])
    both = tables.compare(measures.our_cells(store.load(tmp_path)), store.paper_cells())
    assert both["other_budget"].all() and both["difference"].isna().all() and (both["paper_task"] == "mpe-tag").all()


def test_two_values_at_the_games_bound_are_not_counted():
    """In LBF no return is above 1, in Spread no bound is reached, and a maximum below the bound could differ."""
    rows = [
        ("lbf-8x8-2p-2f-c", "ia2c", "max_return", 1.0, np.nan, 1, 1.0, 0.0),
        ("lbf-8x8-2p-2f-c", "ippo", "max_return", 0.98, np.nan, 1, 1.0, 0.0),
        ("lbf-8x8-2p-2f-c", "mappo", "max_return", 1.0, np.nan, 1, 1.0, 0.01),
        ("mpe-spread", "ia2c", "max_return", -130.0, np.nan, 1, -130.0, 0.0),
        ("mpe-spread", "ippo", "max_return", -130.0, 0.004, 3, -130.0, 0.0),  # it varies, though it is printed as 0.00
    ]
    assert agreement.is_trivial(cells(*rows)).tolist() == [True, False, False, False, False]


@pytest.mark.slow
def test_all_results_and_the_papers_lie_within_the_games_bounds(committed):
    """As far as five decimals."""
    paper = store.paper_cells()
    paper = paper[paper["metric"].isin(agreement.METRICS)].rename(columns={"mean": "return_mean"})
    for rows in (committed.evaluations, paper):
        for task, values in rows.groupby("task")["return_mean"]:
            low, high = envs.task(task).returns
            assert values.between(low - 1e-5, high + 1e-5).all(), task


@pytest.mark.slow
def test_the_report_says_what_agrees(committed):
    """With seed 0 alone, with the planned seeds, and with all: each counted here from the evaluations of all runs."""
    said = committed.agreement()
    rows = zip(committed.shown["task"], committed.shown["sharing"])
    planned = committed.shown["seed"] < [committed.planned.get(row, np.inf) for row in rows]
    found = []
    for chosen in (committed.shown["seed"] == 0, planned, committed.shown["seed"] >= 0):
        rows = committed.shown[chosen].drop(columns="other_budget")
        counted = agreement.counted(tables.compare(measures.our_cells(rows), store.paper_cells()))
        counted = counted[counted["family"] != "matrix"]
        own = counted[counted["apart"] == ""]
        found.append((agreement.numbers(own["agrees"]), agreement.numbers(counted["agrees"])))
    assert said.startswith(f"With seed 0 alone, {found[0][0]} of our average and maximum returns agree")
    assert f"planned for its row, {found[1][0]} agree, and with all seeds {found[2][0]}. The last figure" in said
    assert f"with these two, {found[0][1]} agree with seed 0, and {found[2][1]} with all." in said


def test_the_three_places_have_the_same_sentences(committed):
    """README and RESULTS.md in their own text; the page gets the sentences from the report when it is built."""
    said = report.fill(committed.agreement())
    root = store.HERE.parent
    assert said in (root / "README.md").read_text(encoding="utf-8")
    assert " ".join(said.split()) in " ".join((root / "benchmark" / "RESULTS.md").read_text(encoding="utf-8").split())
    assert "```{agreement}" in (root / "docs" / "paper-run-again.md").read_text(encoding="utf-8")


def test_tables_by_family(committed):
    lines = [line.split(" | ") for line in committed.agreement_table().splitlines() if line.startswith("| ")]
    for row, family, sharing in (
        ("| LBF, with parameter sharing", "lbf", store.SHARED),
        ("| RWARE, with parameter sharing", "rware", store.SHARED),
        ("| RWARE, without parameter sharing", "rware", store.INDEPENDENT),
    ):
        [found] = [line for line in lines if line[0] == row]
        for column, metric in ((1, "average_return"), (4, "max_return")):
            for place, cells in ((column, committed.counted_first), (column + 1, committed.counted_planned)):
                chosen = cells[
                    (cells["family"] == family) & (cells["sharing"] == sharing) & (cells["metric"] == metric)
                ]
                assert found[place] == agreement.numbers(chosen["agrees"])
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in committed.agreement_in_short().splitlines()]
    header, _, first, planned, others = table
    rware, column = "family == 'rware' and metric == 'average_return'", header.index("RWARE")
    chosen = committed.counted_planned.query(rware)
    assert first[column] == agreement.numbers(committed.counted_first.query(rware)["agrees"])
    assert planned[column] == agreement.numbers(chosen["agrees"])
    assert others[column] == agreement.percent(agreement.placebo(chosen)["agrees"])


def test_what_was_run_of_the_papers_tables(committed):
    """Counted from the evaluations of all runs."""
    said, runs = committed.coverage(), committed.evaluations
    runs = runs[measures.has_paper_setting(runs)][["task", "sharing", "algorithm", "seed"]].drop_duplicates()
    runs = runs[~runs["task"].map(store.has_older_rules)]
    stand_ins = runs["task"].str.startswith("smaclite")
    for chosen, words in ((~stand_ins, "cells {} were run here, with {} runs"), (stand_ins, "{} more, with {} runs")):
        cells = runs[chosen & (runs["seed"] < 5)]
        number = len(cells[["task", "sharing", "algorithm"]].drop_duplicates())
        assert words.format(number, len(cells)) in said
    assert "have 450 cells of five runs each, 2,250 in all" in said
    assert said.endswith("Nothing was run without parameter sharing of SMAC, LBF.")
    lines = committed.coverage_table().splitlines()
    assert len(lines) == 12 and "| LBF, without parameter sharing | 0 of 63 | 0 of 315 | - |" in lines


# ---------------------------------------------------------------------------------------------------- sentences


def test_sentences_of_the_pages_that_new_results_may_change(committed):
    """Each stands in docs/paper-run-again.md or a page of docs/paper-run-again/, which is to be read when it fails."""
    page = store.HERE.parent / "docs" / "paper-run-again"
    counted = committed.counted
    outside = counted[~counted["agrees"]]

    def where(algorithm, sharing="shared"):
        rows = outside[(outside["algorithm"] == algorithm) & (outside["sharing"] == sharing)]
        return {task for task in rows["task"] if not task.startswith("matrix")}

    foraging = {"lbf-8x8-2p-2f-c", "lbf-8x8-2p-2f-2s-c", "lbf-10x10-3p-3f"}
    assert {task for task in where("maddpg") if task.startswith("lbf")} == foraging, page / "maddpg.md"
    assert not where("maddpg") & {"mpe-spread", "mpe-speaker-listener"}, page / "maddpg.md"
    assert "mpe-speaker-listener" not in where("maa2c"), page / "speaker-listener.md"
    assert "mpe-speaker-listener" not in where("ia2c", "independent"), page / "speaker-listener.md"
    assert {name for name in store.ALGORITHMS if "mpe-tag" in where(name, "independent")} == {"maddpg"}
    battles = {"smaclite-3s_vs_5z-sc2-v2", "smaclite-2s_vs_1sc-sc2", "smaclite-corridor-sc2-v2"}
    assert where("ia2c") - battles == {"rware-small-4p"}
    first = committed.shown[(committed.shown["task"] == "mpe-tag") & (committed.shown["seed"] == 0)]
    own = first[first["sharing"] == "shared"].groupby("algorithm")["return_mean"].mean()
    paper = committed.paper.set_index(["metric", "sharing", "task"]).loc[("average_return", "shared", "mpe-tag")]
    assert (own > paper.set_index("algorithm")["mean"].reindex(own.index)).sum() == 7, page / "adversary-and-tag.md"
