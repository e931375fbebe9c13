"""The paper's claims: what their words mean, what an expression can say, and when a verdict is too close to call."""

import numpy as np
import pandas as pd
import pytest

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
    return eval(claims.compiled(expression), {}, scope(*of_scope, **of_table))


def claim(beginning):
    """The claim that begins so."""
    [found] = [each for each in claims.CLAIMS if each.sentence.startswith(beginning)]
    return found


def verdict_on(beginning, cells):
    return claim(beginning).judge(claims.View.of(cells)).verdict


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


def test_two_seeds_do_not_show_that_there_is_no_difference():
    near, far = {"maa2c": 10, "ia2c": 5}, {"maa2c": 10, "ia2c": 5, "mappo": 10.5}
    assert says("significantly_above(maa2c, ia2c)", near, seeds=2, interval=0.1)
    for seeds in (1, 2, 4):
        with pytest.raises(claims.NotMeasured):
            says("significantly_above(maa2c, ia2c)", near, seeds=seeds, interval=8.0)
        with pytest.raises(claims.NotMeasured):
            says("similar(maa2c, ia2c) or matches_best(ia2c)", far, seeds=seeds, interval=8.0)
    assert not says("significantly_above(maa2c, ia2c)", near, interval=8.0)
    assert says("similar(maa2c, ia2c) and matches_best(ia2c)", far, interval=8.0)


# ---------------------------------------------------------------------------------------------------- claims


def test_the_papers_claims_by_its_own_tables():
    verdicts = claims.judge(store.paper_cells())
    assert {each.verdict for each in verdicts} == {claims.HOLDS, claims.FAILS} and len(verdicts) == 53
    failing = [claim.sentence[:40] for claim, each in zip(claims.CLAIMS, verdicts) if each.verdict == claims.FAILS]
    assert failing == [
        "IQL performs significantly worse than IA",
        "IQL performs competitively in the other ",
        "IPPO in general performs competitively i",
        "IPPO outperforms MAA2C in the RWARE task",
        "Centralised critics are valuable (the be",
        "In most RWARE tasks MAA2C and MAPPO sign",
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


def test_each_claim_names_tasks_and_what_is_needed():
    for each in claims.CLAIMS:
        assert each.places and 1 <= (1 if each.needed == "code" else each.enough()) <= len(each.places)
        assert {key[2] for key in each.cells()} <= {*claims.TASKS}
        assert (each.expression in claims.CODE) == (each.needed == "code")


def test_the_papers_own_task_goes_before_the_one_that_stands_in_for_it():
    own, stand_in = ("smac-3s5z", "smac-3s5z", "mappo", 1.0, 5), ("smaclite-3s5z-sc2", "smac-3s5z", "mappo", 2.0, 5)
    key = "max_return", "shared", "smac-3s5z", "mappo"
    for runs in ([own, stand_in], [stand_in, own]):
        assert claims.View.of(named_cells(runs)).cell(*key).value == 1
    assert claims.View.of(named_cells([stand_in])).cell(*key).value == 2


def test_the_claims_do_not_compare_two_games():
    """Where nearly all was run on the stand-in, one algorithm's result of the paper's own task is left aside."""
    runs = [("smaclite-3s5z-sc2", "smac-3s5z", name, 1.0, 5) for name in store.ALGORITHMS]
    view = claims.View.of(named_cells([*runs, ("smac-3s5z", "smac-3s5z", "mappo", 9.0, 5)]))
    assert set(view.values("max_return", "shared", "smac-3s5z").values()) == {1}


def test_the_luck_of_untrained_networks_does_not_count():
    """IQL's maximum before training is the best; the average over training takes its place."""
    maxima = table({"matrix-climbing": dict.fromkeys(store.ALGORITHMS, 175) | {"iql": 195}})
    averages = table({"matrix-climbing": dict.fromkeys(store.ALGORITHMS, 150)}, "average_return")
    paper = claims.View.of(pd.concat([maxima, averages]))  # that these maxima are untrained is known
    ours = pd.concat([maxima, averages]).assign(paper_task="matrix-climbing", other_budget=False)
    ours["at_start"] = (ours["algorithm"] == "iql") & (ours["metric"] == "max_return")
    for view, best in ((paper, 175), (claims.View.of(ours), 175)):
        assert claims.Scope(view, "matrix-climbing", "max_return").best == best
        assert view.cell("max_return", "shared", "matrix-climbing", "iql").value == 150


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
    found = claims.sharing_significant(claims.View.of(pd.concat([table(better), table(worse, sharing="independent")])))
    assert found.verdict == claims.HOLDS and found.figures.startswith(
        "3 of 225 pairs, 216 not measured: IQL on mpe-tag"
    )


def test_claims_about_averages_look_at_averages():
    ippo_wins = {task: {"ippo": 2, "ia2c": 1} for task in claims.SETS["rware"]}
    ia2c_wins = {task: {"ippo": 1, "ia2c": 2} for task in claims.SETS["rware"]}
    found = claims.judge(pd.concat([table(ippo_wins, "average_return"), table(ia2c_wins)]))
    figures = dict(zip((each.sentence for each in claims.CLAIMS), (each.figures for each in found)))
    assert figures[claim("On average over training, IPPO").sentence].startswith("1 of 4 families")


def test_a_claim_is_decided_once_missing_tasks_cannot_change_it():
    decided = claims.verdict_of
    assert decided({"a": True, "b": True, "c": None}, 3) == claims.UNKNOWN
    assert decided({"a": False, "b": None}, 2) == claims.FAILS
    assert decided({"a": True, "b": True, "c": None}, 2) == claims.HOLDS
    assert decided({"a": True, "b": False, "c": None}, 2) == claims.UNKNOWN
    of_all = [each for each in claims.CLAIMS if each.tasks == "all" and each.needed != "code"]
    assert {each.needed: each.enough() for each in of_all} == {"majority": 13, "three quarters": 19}


# ---------------------------------------------------------------------------------------------------- too close to call


def of_rware(first, second, seeds):
    """MAPPO and IPPO on the three tasks of RWARE, all others at 0."""
    return table({task: {"mappo": first, "ippo": second} for task in claims.SETS["rware"]}, seeds=seeds)


def best_in_rware(*cells):
    found = dict(zip(claims.CLAIMS, claims.judge(of_rware(*cells), {("shared", "rware-tiny-2p", "mappo"): 0.5})))
    return found[claim("MAPPO's returns in RWARE exceed")]


def test_a_narrow_difference_of_single_seeds_is_too_close_to_call():
    narrow, wide, complete = best_in_rware(20.2, 20.1, 1), best_in_rware(90, 20, 1), best_in_rware(20.2, 20.1, 5)
    assert (narrow.verdict, wide.verdict, complete.verdict) == (claims.CLOSE, claims.HOLDS, claims.HOLDS)
    assert narrow.rests_on.startswith("holds as it is, and in") and "rware-tiny-2p" in narrow.rests_on
    assert "one seed more of each: 0.5 CPU hours" in wide.rests_on and not complete.rests_on


def test_cells_are_completed_with_the_papers_spread():
    """The mean of five seeds, n of which are known, varies by s^2 (1 / n - 1 / 5) about that of the n."""
    where = "max_return", "shared", "rware-tiny-2p", "mappo"  # the paper: 21.16 +- 1.50
    paper = claims.View.of(store.paper_cells())
    deviation = 1.50 * np.sqrt(5) / 2
    for seeds, spread in ((1, deviation), (3, np.sqrt(4 * deviation**2 / 6))):  # the three seeds are all the same
        view = claims.View({where: claims.Cell(20.0, 0.0, seeds)})
        drawn = [each.cell(*where) for each in claims.completed(view, paper)]
        assert {cell.seeds for cell in drawn} == {5} and len(drawn) == claims.DRAWS
        means = np.array([cell.value for cell in drawn])
        assert means.mean() == pytest.approx(20, abs=4 * spread / np.sqrt(claims.DRAWS))
        assert means.std() == pytest.approx(spread * np.sqrt(1 / seeds - 1 / 5), rel=0.15)
    ours = claims.View({where: claims.Cell(20.0, 1.0, 5)})
    assert claims.completed(ours, paper)[0].cells == ours.cells


def test_verdicts_do_not_depend_on_what_was_judged_before():
    cells = pd.concat([of_rware(9, 1, 1), table({task: {} for task in claims.SETS["lbf"]})])
    first, second = claims.judge(cells), claims.judge(cells)
    assert first == second
    said = dict(zip((each.sentence for each in claims.CLAIMS), first))
    assert not said["QMIX is not above VDN in most LBF tasks."].rests_on
    assert "fewer than five seeds" in said[claim("MAPPO's returns in RWARE exceed").sentence].rests_on
