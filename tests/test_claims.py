"""The paper's claims: what their words mean, what an expression can say, and when a verdict is too close to call."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_ind_from_stats

import envs
from benchmark import claims, measures, store

SPREAD = "mpe-spread"


def table(values, metric="max_return", seeds=5, interval=0.001, sharing="shared"):
    """Cells in the form of `store.paper_cells`; values: by task, of algorithms that are named; of the others 0."""
    rows = [
        (metric, sharing, task, algorithm, float(named.get(algorithm, 0)), interval, seeds)
        for task, named in values.items()
        for algorithm in store.ALGORITHMS
    ]
    return pd.DataFrame(rows, columns=["metric", "sharing", "task", "algorithm", "mean", "interval", "seeds"])


def scope(values, task=SPREAD, **of_table):
    return claims.Scope(claims.View.of(table({task: values}, **of_table)), task, "max_return")


def says(expression, *of_scope, **of_table):
    return bool(np.all(claims.compiled(expression)(scope(*of_scope, **of_table))))


def claim(beginning):
    """The claim that begins so."""
    [found] = [each for each in claims.CLAIMS if each.sentence.startswith(beginning)]
    return found


def verdict_on(beginning, cells):
    found, _ = claim(beginning).judge(claims.View.of(cells))
    return found.verdict


def value(view, *key):
    [found] = view.cells[key].value
    return found


def named_cells(runs, **columns):
    """Cells in the form of `measures.our_cells`; runs: (task, paper's task, algorithm, value, seeds)."""
    rows = [("max_return", "shared", *run) for run in runs]
    names = ["metric", "sharing", "task", "paper_task", "algorithm", "mean", "seeds"]
    cells = pd.DataFrame(rows, columns=names).assign(interval=0.001, other_budget=False, at_start=False)
    return cells.assign(**columns)


# ---------------------------------------------------------------------------------------------------- expressions


def test_what_expressions_mean():
    values = {"iql": 1, "ia2c": 4, "mappo": 10}
    assert says("max(iql, ia2c) < 0.5 * best and not iql == ia2c", values)
    assert says("-iql + ia2c - 1 == 2 and abs(iql - ia2c) / 3 == 1", values)
    assert says("iql > ia2c if lbf else mpe", values) and not says("lbf or large_lbf", values)
    assert says("scaled(ia2c) == 0.4 and lower(ia2c) == 7", values)


def test_the_limits_of_competitive_and_similar():
    values = {"mappo": 1, "ippo": 0.81, "ia2c": 0.77, "coma": 0.72, "iql": 0.62}
    assert says("competitive(ippo)", values) and not says("competitive(ia2c)", values)
    assert says("similar(ippo, coma)", values) and not says("similar(ia2c, iql)", values)
    assert says("competitive(ia2c, coma, iql)", values)  # among these alone
    assert all(
        says(f"competitive({name})", {each: 99 + (each == "iql") for each in store.ALGORITHMS}) for name in values
    )


def test_what_is_not_significantly_different_from_the_best_is_competitive():
    """One lucky seed of MADDPG: 90 +- 80, all others 50 +- 0."""
    cells = table({"matrix-penalty-25": dict.fromkeys(store.ALGORITHMS, 50) | {"maddpg": 90}}, interval=0.0)
    cells.loc[cells["algorithm"] == "maddpg", "interval"] = 80.0
    view = claims.View.of(cells)
    assert all(claims.Scope(view, "matrix-penalty-25", "max_return").competitive(name) for name in store.ALGORITHMS)


@pytest.mark.parametrize("seeds, expected", [(2, False), (5, True)])
def test_significance_is_students(seeds, expected):
    """The same means and deviations, with few seeds and with more."""
    cells = [claims.Cell(np.array([value]), np.array([2 * 1.5 / np.sqrt(seeds)]), seeds) for value in (10.0, 7.0)]
    assert scope({}).different(*cells) == [expected]
    p = ttest_ind_from_stats(10, 1.5, seeds, 7, 1.5, seeds).pvalue
    assert (p < 0.05) == expected


def test_what_significance_says():
    near, far = {"maa2c": 10, "ia2c": 5}, {"maa2c": 10, "ia2c": 5, "mappo": 10.5}
    assert says("significantly_above(maa2c, ia2c)", near, interval=0.1)
    assert not says("significantly_above(maa2c, ia2c)", near, interval=8.0)
    assert says("similar(maa2c, ia2c) and matches_best(ia2c)", far, interval=8.0)


@pytest.mark.parametrize(
    "expression",
    [
        *("iql.__class__", "scaled.__globals__", "(lambda: 1)()", "[iql][0]", "max.__self__", "open(iql)", "nothing"),
        *(
            "best(iql)",
            "scaled(iql + 1)",
            "scaled(best)",
            "scaled()",
            "iql < ia2c < ippo",
            "'iql'",
            "iql ** 2",
            "x := 1",
        ),
        *("__import__(iql)", "tie", "value(iql)", "competitive(algorithm=iql)", "1 if iql > 2 else 0", "max()"),
    ],
)
def test_expressions_say_nothing_else(expression):
    with pytest.raises((envs.InputError, SyntaxError)):
        claims.compiled(expression)


def test_near_values_are_ties():
    """249.9 of at most 250 are a tie with 250, also for what is made of them; 249 are none, and where a game has no
    bound there are none."""
    task = "matrix-penalty-0"
    near = dict.fromkeys(store.ALGORITHMS, 250) | {"maddpg": 249.9}
    assert says("not maddpg < iql and maddpg >= iql and maddpg == best and lower(iql) == 0", near, task)
    assert says("scaled(maddpg) == 1 and matches_best(maddpg) and not significantly_above(iql, maddpg)", near, task)
    assert says("maddpg < iql and lower(iql) == 1 and scaled(maddpg) == 0", near | {"maddpg": 249}, task)
    assert says("significantly_above(iql, maddpg)", near | {"maddpg": 249}, task)
    assert says("maddpg < iql and maddpg != best", near, SPREAD)
    strict = dataclasses.replace(claims.View.of(table({task: near})), ties=False)
    assert claims.compiled("maddpg < iql")(claims.Scope(strict, task, "max_return"))


def test_only_returns_are_ties():
    """On Penalty games a tie is 0.25 apart, which is nothing for a place on the scale or a number of algorithms."""
    values = {"iql": 100, "ia2c": 40}
    assert not says("scaled(ia2c) >= 0.5", values, "matrix-penalty-0")
    assert says("lower(ia2c) > 6.9", values, "matrix-penalty-0")


# ---------------------------------------------------------------------------------------------------- claims


def test_the_papers_claims_by_its_own_tables():
    verdicts = claims.judge(store.paper_cells())
    assert {(each.error, each.open) for each in verdicts} == {(0, 0)}
    assert {each.verdict for each in verdicts} == {claims.HOLDS, claims.FAILS} and len(verdicts) == 53
    failing = [claim.sentence[:40] for claim, each in zip(claims.CLAIMS, verdicts) if each.verdict == claims.FAILS]
    assert failing == [
        "IQL performs significantly worse than IA",
        "IQL performs competitively in the other ",
        "IPPO in general performs competitively i",
        "IPPO outperforms MAA2C in the RWARE task",
        "Centralised critics are valuable (the be",
        "In most RWARE tasks MAA2C and MAPPO sign",
        "MADDPG performs worse than all other alg",
        "MAPPO performs only slightly worse (by l",
        "MAPPO's surrogate objective significantl",
        "VDN and QMIX perform similarly across al",
        "QMIX achieves consistently high returns ",
        "IA2C and IPPO should be expected to achi",
        "MAA2C is significantly better than IA2C ",
        "Value decomposition improves upon IQL ac",
    ]


def test_claims_wait_for_results():
    verdicts = claims.judge(named_cells([("mpe-spread", "mpe-spread", "mappo", 1.0, 1)]))
    assert {verdict.verdict for verdict in verdicts} == {claims.UNKNOWN}


def test_ties_decide_one_of_the_papers_verdicts():
    """MADDPG has 249.98 on one Penalty game, 49.97 or 49.98 on others, and all others have 250 or 50."""
    paper = store.paper_cells()
    beginning = "MADDPG performs worse than all other algorithms"
    changed = [each for each in zip(claims.CLAIMS, claims.judge(paper)) if each[1].strict != each[1].verdict]
    [(claimed, verdict)] = changed
    assert claimed.sentence.startswith(beginning)
    assert (verdict.verdict, verdict.strict) == (claims.FAILS, claims.HOLDS)


def test_each_claim_names_tasks_and_what_is_needed():
    view = claims.View.of(store.paper_cells())
    for each in claims.CLAIMS:
        assert each.places and 1 <= each.enough() <= len(each.places)
        _, asked = each.judge(view)
        assert set().union(*asked.values()) <= view.cells.keys()


def test_the_papers_own_task_goes_before_the_one_that_stands_in_for_it():
    own, stand_in = ("smac-3s5z", "smac-3s5z", "mappo", 1.0, 5), ("smaclite-3s5z-sc2-v2", "smac-3s5z", "mappo", 2.0, 5)
    key = "max_return", "shared", "smac-3s5z", "mappo"
    for runs in ([own, stand_in], [stand_in, own]):
        assert value(claims.View.of(named_cells(runs)), *key) == 1
    alone = claims.View.of(named_cells([stand_in]))
    assert value(alone, *key) == 2 and alone.games == {"smac-3s5z": "smaclite-3s5z-sc2-v2"}
    assert not alone.without_stand_ins().cells and claims.View.of(named_cells([own])).without_stand_ins().cells


def test_the_claims_do_not_compare_two_games():
    """Where nearly all was run on the stand-in, one algorithm's result of the paper's own task is left aside."""
    runs = [("smaclite-3s5z-sc2-v2", "smac-3s5z", name, 1.0, 5) for name in store.ALGORITHMS]
    view = claims.View.of(named_cells([*runs, ("smac-3s5z", "smac-3s5z", "mappo", 9.0, 5)]))
    assert (claims.Scope(view, "smac-3s5z", "max_return").values() == 1).all()


def test_the_luck_of_untrained_networks_does_not_count():
    """IQL's maximum before training is the best; the average over training takes its place."""
    maxima = table({"matrix-climbing": dict.fromkeys(store.ALGORITHMS, 175) | {"iql": 195}})
    averages = table({"matrix-climbing": dict.fromkeys(store.ALGORITHMS, 150)}, "average_return")
    paper = claims.View.of(pd.concat([maxima, averages]))  # that these maxima are untrained is known
    ours = pd.concat([maxima, averages]).assign(paper_task="matrix-climbing", other_budget=False)
    ours["at_start"] = (ours["algorithm"] == "iql") & (ours["metric"] == "max_return")
    for view, best in ((paper, 175), (claims.View.of(ours), 175)):
        assert claims.Scope(view, "matrix-climbing", "max_return").best() == [best]
        assert value(view, "max_return", "shared", "matrix-climbing", "iql") == 150


@pytest.mark.slow
def test_which_maxima_of_the_paper_are_untrained():
    """Those of our runs that lie before training, and are the paper's to the cent."""
    ours = measures.our_cells(store.load())
    ours = ours[ours["at_start"] & (ours["metric"] == "max_return")]
    found = set(ours[["metric", "sharing", "task", "algorithm"]].itertuples(index=False, name=None))
    assert found == claims.UNTRAINED
    both = ours.merge(store.paper_cells(), on=["metric", "sharing", "task", "algorithm"])
    assert len(both) == len(ours) and (both["mean_x"] - both["mean_y"]).abs().max() < 0.005


def test_a_tie_is_no_improvement():
    for qmix, verdict in ((50, claims.FAILS), (51, claims.HOLDS)):
        values = {task: {"iql": 50, "vdn": 50, "qmix": qmix} for task in claims.TASKS}
        parts = table(values), table(values, "average_return")
        assert verdict_on("Value decomposition improves upon IQL", pd.concat(parts)) == verdict


def test_that_sharing_improves_is_not_said_of_the_matrix_games():
    """They are complete, and sharing is worse there; of the families that the sentence is about nothing is known."""
    task = "matrix-penalty-0"
    parts = [
        table({task: {"iql": 9, "ia2c": with_sharing}}, sharing=sharing)
        for sharing, with_sharing in (("shared", 0), ("independent", 9))
    ]
    assert verdict_on("In all environments except the matrix games, parameter", pd.concat(parts)) == claims.UNKNOWN


def test_competitive_only_in_some_tasks():
    """Each algorithm is competitive in the tasks that are named, where it is the best, and in no other."""
    best = {task: {"mappo": 1} for task in claims.TASKS}
    averages = table(best, "average_return")
    mpe, smac, lbf = SPREAD, list(claims.SETS["smac"][:2]), claims.SETS["lbf"][0]
    for name, tasks, verdict in (
        ("MADDPG", [mpe], claims.HOLDS),
        ("MADDPG", [], claims.FAILS),
        ("MADDPG", [mpe, lbf], claims.FAILS),
        ("COMA", smac[:1], claims.HOLDS),
        ("COMA", smac, claims.FAILS),
        ("COMA", [], claims.FAILS),
        ("COMA", [mpe, smac[0]], claims.FAILS),
    ):
        cells = pd.concat([averages, table(best | {task: {name.lower(): 1} for task in tasks})])
        assert verdict_on(f"{name} performs competitively only", cells) == verdict


@pytest.mark.parametrize(
    "gains, verdict",
    [([3, 1, 2], claims.HOLDS), ([1, 3, 2], claims.FAILS), ([3, 2, 1], claims.FAILS), ([0, 0, 0], claims.FAILS)],
)
def test_sharing_where_rewards_are_sparse(gains, verdict):
    """Of tiny-2p, tiny-4p and small-4p: ten with sharing, less without, by all algorithms but one; or 0 by all."""
    parts = []
    for task, gain in zip(("rware-tiny-2p", "rware-tiny-4p", "rware-small-4p"), gains):
        best = 10 if gain else 0
        for sharing, value in (("shared", best), ("independent", best - gain)):
            parts.append(table({task: dict.fromkeys(store.ALGORITHMS[1:], value)}, sharing=sharing))
    assert verdict_on("In RWARE, sharing helps more", pd.concat(parts)) == verdict


def test_several_significant_cases_of_sharing():
    better, worse = ({"mpe-tag": dict.fromkeys(store.ALGORITHMS[:3], value)} for value in (5, 1))
    cells = pd.concat([table(better), table(worse, sharing="independent")])
    found = claims.judge(cells)[claims.CLAIMS.index(claim("In several cases"))]
    assert found.verdict == claims.HOLDS
    assert found.figures.startswith("3 of 225 pairs, 216 not measured; yes: IQL on mpe-tag (5.00, 1.00 without)")


def test_claims_about_averages_look_at_averages():
    ippo_wins = {task: {"ippo": 2, "ia2c": 1} for task in claims.SETS["rware"]}
    ia2c_wins = {task: {"ippo": 1, "ia2c": 2} for task in claims.SETS["rware"]}
    found = claims.judge(pd.concat([table(ippo_wins, "average_return"), table(ia2c_wins)]))
    figures = dict(zip((each.sentence for each in claims.CLAIMS), (each.figures for each in found)))
    assert figures[claim("On average over training, IPPO").sentence].startswith("1 of 4 families")


def verdict_from(enough, *shares):
    """Of places of which each holds in this share of 10,000 tables, the first ones; None: not measured."""
    draws = 10_000
    outcomes = {str(k): None if share is None else np.arange(draws) < share * draws for k, share in enumerate(shares)}
    return claims.verdict_of(outcomes, enough, draws)


def test_a_claim_is_decided_once_missing_tasks_cannot_change_it():
    for enough, shares, verdict in (
        (3, (1, 1, None), claims.UNKNOWN),
        (2, (0, None), claims.FAILS),
        (2, (1, 1, None), claims.HOLDS),
        (2, (1, 0, None), claims.UNKNOWN),
    ):
        assert verdict_from(enough, *shares).verdict == verdict
    of_all = [each for each in claims.CLAIMS if each.tasks == "all"]
    assert {each.needed: each.enough() for each in of_all} == {"majority": 13, "three quarters": 19}


def test_the_error_of_a_share_counts():
    """Twice the standard error of 95 % in 10,000 draws is 0.44 %."""
    for share, verdict in (
        (0.957, claims.HOLDS),
        (0.953, claims.CLOSE),
        (0.5, claims.CLOSE),
        (0.047, claims.CLOSE),
        (0.043, claims.FAILS),
    ):
        found = verdict_from(1, share)
        assert found.verdict == verdict and found.share == pytest.approx(share)
        assert found.error == pytest.approx(2 * np.sqrt(share * (1 - share) / 10_000)) and found.error <= 0.01
    assert 2 * np.sqrt(0.25 / claims.DRAWS) < 0.01


def test_what_is_open_is_not_measured_where_it_can_decide():
    """Two are needed. The first place holds in half of the tables; the third is missing."""
    open_to_both = verdict_from(2, 0.5, 1, None)
    assert open_to_both.verdict == claims.UNKNOWN and open_to_both.open == 0.5
    assert verdict_from(2, 0.5, 0.02, None).verdict == claims.UNKNOWN  # it can fail in all
    assert verdict_from(2, 0.5, 0.5, None).shares == "50.0 ± 1.0 %"
    both = verdict_from(1, 0.5, 0.3)
    assert both.verdict == claims.CLOSE and both.open == 0


# ---------------------------------------------------------------------------------------------------- too close to call


def of_rware(first, second, seeds):
    """MAPPO and IPPO on the three tasks of RWARE, all others at 0."""
    return table({task: {"mappo": first, "ippo": second} for task in claims.SETS["rware"]}, seeds=seeds)


def best_in_rware(*cells):
    found = dict(zip(claims.CLAIMS, claims.judge(of_rware(*cells), {("shared", "rware-tiny-2p", "mappo"): 0.5})))
    return found[claim("MAPPO's returns in RWARE exceed")]


@pytest.mark.slow
def test_a_narrow_difference_of_single_seeds_is_too_close_to_call():
    narrow, wide, complete = best_in_rware(20.2, 20.1, 1), best_in_rware(90, 20, 1), best_in_rware(20.2, 20.1, 5)
    assert (narrow.verdict, wide.verdict, complete.verdict) == (claims.CLOSE, claims.HOLDS, claims.HOLDS)
    assert 0.05 < narrow.share < 0.95 and "rware-tiny-2p" in narrow.rests_on and not narrow.alone
    assert "one seed more of each: 0.5 CPU hours" in wide.rests_on and not complete.rests_on


def test_a_verdict_on_stand_ins_says_so():
    """Three of five tasks are needed: with three of the paper's it holds without the stand-in, with two it does not."""
    claimed = claim("VDN and QMIX perform similarly in most")
    stand_in = [("smaclite-3s5z-sc2-v2", "smac-3s5z", name, 1.0, 5) for name in store.ALGORITHMS]
    others = [task for task in claims.SETS["smac"] if task != "smac-3s5z"]
    for number, alone in ((3, claims.HOLDS), (2, claims.UNKNOWN)):
        runs = [(task, task, name, 1.0, 5) for task in others[:number] for name in store.ALGORITHMS]
        found = claims.judge(named_cells(runs + stand_in))[claims.CLAIMS.index(claimed)]
        assert found.verdict == claims.HOLDS and found.alone.startswith(f"{alone}, ")


def test_stand_ins_have_their_own_name():
    task = "smac-3s_vs_5z"
    runs = [("smaclite-3s_vs_5z-sc2-v2", task, name, 2.0 + (name == "iql"), 5) for name in store.ALGORITHMS]
    found = dict(zip(claims.CLAIMS, claims.judge(named_cells(runs))))
    best = found[claim("IQL achieves the best performance")]
    assert best.figures == "1 of 1 tasks; yes: smaclite-3s_vs_5z-sc2-v2 (IQL 3.00, best 3.00)"
    assert best.alone == "not measured, 0.0 ± 0.0 %; open in 100.0 %"
    texts = [text for each in found.values() for text in (each.figures, each.rests_on)]
    assert not any("smac-" in text for text in texts)


def test_cells_are_completed_with_the_papers_spread():
    """The mean of five seeds, n of which are known, varies by s^2 (1 / n - 1 / 5) about that of the n."""
    where = "max_return", "shared", "rware-tiny-2p", "mappo"  # the paper: 21.16 +- 1.50
    paper = claims.View.of(store.paper_cells())
    deviation = 1.50 * np.sqrt(5) / 2
    for seeds, spread in ((1, deviation), (3, np.sqrt(4 * deviation**2 / 6))):  # the three seeds are all the same
        view = claims.View({where: claims.Cell(np.array([20.0]), np.array([0.0]), seeds)}, {})
        drawn = claims.completed(view, paper).cell(where)
        assert drawn.seeds == 5 and drawn.value.shape == drawn.interval.shape == (claims.DRAWS,)
        assert drawn.value.mean() == pytest.approx(20, abs=4 * spread / np.sqrt(claims.DRAWS))
        assert drawn.value.std() == pytest.approx(spread * np.sqrt(1 / seeds - 1 / 5), rel=0.05)
    ours = claims.View({where: claims.Cell(np.array([20.0]), np.array([1.0]), 5)}, {})
    kept = claims.completed(ours, paper).cell(where)
    assert (kept.value == 20).all() and (kept.interval == 1).all() and kept.seeds == 5


def test_no_draw_is_beyond_the_games_bounds():
    """The paper's COMA has 0.61 +- 0.30 on this task, so that draws around 0.95 would often be above 1."""
    view = claims.View.of(table({"lbf-8x8-2p-2f-c": {"coma": 0.95}}, seeds=1))
    drawn = claims.completed(view, claims.View.of(store.paper_cells()))
    values = np.concatenate([cell.value for cell in drawn.cells.values()])
    assert values.min() >= 0 and values.max() <= 1
    coma = drawn.cell(("max_return", "shared", "lbf-8x8-2p-2f-c", "coma")).value
    assert coma.std() > 0.05 and coma.max() > 0.98


@pytest.mark.slow
def test_verdicts_do_not_depend_on_what_was_judged_before():
    cells = pd.concat([of_rware(9, 1, 1), table({task: {} for task in claims.SETS["lbf"]})])
    first, second = claims.judge(cells), claims.judge(cells)
    assert first == second
    said = dict(zip((each.sentence for each in claims.CLAIMS), first))
    assert not said["QMIX is not above VDN in most LBF tasks."].rests_on
    assert "fewer than five seeds" in said[claim("MAPPO's returns in RWARE exceed").sentence].rests_on
