"""What the paper's sections 5 and 6 claim, each as a small function of a set of results.

A claim looks at maximum returns with sharing unless it says otherwise. Where the paper's words leave it open, these are
the words' meanings here:

    significantly     two-sided Student t-test at 0.05, as the paper's asterisks
    similar           not significantly different, or less than a tenth of the task's range apart
    competitive       within 1 % of the best, or at least 0.8 on a scale from the task's worst to its best algorithm
    majority, most    more than half of the tasks; vast majority, almost all: at least three quarters
    no learning       less than a tenth of the best algorithm's return

The same functions judge the paper's own tables, since not every sentence agrees with them.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import pandas as pd

from benchmark.store import ALGORITHMS, PAPER_FAMILIES, PAPER_SEEDS, family, paper_cells
from benchmark.tables import same_mean

HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "not measured yet"
TASKS = tuple(dict.fromkeys(paper_cells()["task"]))
MATRIX, MPE, SMAC, LBF, RWARE = (tuple(task for task in TASKS if family(task) == name) for name in PAPER_FAMILIES)
HARD_SMAC = ("smac-corridor", "smac-MMM2")
LARGE_LBF = ("lbf-15x15-3p-5f", "lbf-15x15-4p-3f", "lbf-15x15-4p-5f")
SMALL_LBF = tuple(task for task in LBF if task not in LARGE_LBF)
FULLY_OBSERVABLE = ("mpe-spread", "mpe-adversary", "mpe-tag", *(task for task in LBF if "2s" not in task))
NOT_MATRIX = tuple(task for task in TASKS if task not in MATRIX)
SPEAKER_LISTENER = "mpe-speaker-listener"
INDEPENDENT = ("iql", "ia2c", "ippo")
POLICY_GRADIENT = ("ia2c", "ippo", "maa2c", "mappo")
FAMILIES_BUT_MATRIX = ("mpe", "smac", "rware", "lbf")
MAJORITY, VAST_MAJORITY = 0.5, 0.75
MOST_SHOWN = 4


class NotMeasured(Exception):
    """A claim needs a result that is not there."""


@dataclass(frozen=True)
class Verdict:
    """holds, does not hold or not measured yet, and the figures behind it."""

    verdict: str
    figures: str


def one_game(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells of one game for each of the paper's tasks, so that no comparison mixes two: of that which more
    algorithms were run on, the paper's own or the one that stands in for it; the paper's own, where it is the same."""
    games = cells.groupby(["metric", "sharing", "paper_task", "task"])["algorithm"].nunique().reset_index(name="number")
    games["own"] = games["task"] == games["paper_task"]
    chosen = games.sort_values(["number", "own"]).groupby(["metric", "sharing", "paper_task"]).tail(1)
    return cells.merge(chosen[["metric", "sharing", "paper_task", "task"]])


class View:
    """Results as claims look at them; cells in the form of `results.our_cells` or `results.paper_cells`."""

    def __init__(self, cells: pd.DataFrame):
        if "paper_task" not in cells:
            cells = cells.assign(paper_task=cells["task"], other_budget=False)
        cells = cells[~cells["other_budget"]].rename(columns={"mean": "value"})
        self.cells = {(c.metric, c.sharing, c.paper_task, c.algorithm): c for c in one_game(cells).itertuples()}
        self.few_seeds = False

    def cell(self, algorithm: str, task: str, sharing: bool = True, metric: str = "max_return") -> Any:
        """One cell, with value, interval and seeds. Raises NotMeasured."""
        found = self.cells.get((metric, sharing, task, algorithm))
        if found is None:
            raise NotMeasured
        self.few_seeds |= found.seeds < PAPER_SEEDS
        return found

    def value(self, algorithm: str, task: str, sharing: bool = True, metric: str = "max_return") -> float:
        """A cell's mean. Raises NotMeasured."""
        return self.cell(algorithm, task, sharing, metric).value

    def values(self, task: str) -> dict[str, float]:
        """All nine algorithms' values. Raises NotMeasured."""
        return {algorithm: self.value(algorithm, task) for algorithm in ALGORITHMS}

    def same(self, algorithm: str, other: str, task: str) -> bool:
        """Whether two algorithms are not significantly different. Raises NotMeasured, also for single seeds."""
        one, two = self.cell(algorithm, task), self.cell(other, task)
        if min(one.seeds, two.seeds) < 2:
            raise NotMeasured
        return same_mean(one.value, one.interval, one.seeds, two.value, two.interval, two.seeds)

    def normalised(self, algorithm: str, task: str, metric: str = "max_return") -> float:
        """A value on a scale from the worst to the best algorithm of the task; 1 where all are equal."""
        values = [self.value(name, task, metric=metric) for name in ALGORITHMS]
        low, high = min(values), max(values)
        return (self.value(algorithm, task, metric=metric) - low) / (high - low) if high > low else 1.0

    def competitive(self, algorithm: str, task: str) -> bool:
        """As the module's docstring defines it."""
        best = max(self.values(task).values())
        nearly_best = self.value(algorithm, task) >= best - 0.01 * abs(best)
        return nearly_best or self.normalised(algorithm, task) >= 0.8

    def similar(self, algorithm: str, other: str, task: str) -> bool:
        """As the module's docstring defines it."""
        apart = self.normalised(algorithm, task) - self.normalised(other, task)
        return abs(apart) < 0.1 or self.same(algorithm, other, task)

    def beats(self, algorithm: str, other: str, task: str) -> bool:
        """Whether it is higher, and significantly so."""
        return self.value(algorithm, task) > self.value(other, task) and not self.same(algorithm, other, task)


Test = Callable[[View, str], tuple[bool, str]]  # whether a claim holds on a task, or in a family, and the figures


def among(view: View, tasks: Iterable[str], test: Test, needed: float = 1.0, unit: str = "tasks") -> Verdict:
    """Whether the test holds on enough of the tasks: all of them, or at least the needed share; MAJORITY is more than
    half. It is decided as soon as the tasks that are not measured cannot change it."""
    tasks = list(tasks)
    enough = len(tasks) // 2 + 1 if needed == MAJORITY else math.ceil(needed * len(tasks))
    found: dict[bool, list[str]] = {True: [], False: []}
    missing = 0
    for task in tasks:
        try:
            holds, figures = test(view, task)
        except NotMeasured:
            missing += 1
        else:
            found[bool(holds)].append(f"{task} ({figures})" if figures else task)
    yes, no = found[True], found[False]
    verdict = HOLDS if len(yes) >= enough else FAILS if len(yes) + missing < enough else UNKNOWN
    parts = [f"{len(yes)} of {len(tasks)} {unit}" + (f", {missing} not measured" if missing else "")]
    if yes and len(tasks) <= MOST_SHOWN:
        parts.append(f"yes: {', '.join(yes)}")
    if no:
        parts.append(f"no: {', '.join(no[:MOST_SHOWN])}" + (", ..." if len(no) > MOST_SHOWN else ""))
    return Verdict(verdict, "; ".join(parts) if missing < len(tasks) else "")


# --- tests of one task, by algorithms ---
def values_text(view: View, algorithms: Iterable[str], task: str) -> str:
    """The algorithms' values on a task."""
    return ", ".join(f"{name.upper()} {view.value(name, task):.2f}" for name in algorithms)


def compares(holds: Callable[[View, str], bool], *algorithms: str) -> Test:
    """A condition, shown with these algorithms' values."""
    return lambda view, task: (holds(view, task), values_text(view, algorithms, task))


def higher(algorithm: str, *others: str) -> Test:
    """The first algorithm's value is higher than those of the others."""
    return compares(
        lambda view, task: all(view.value(algorithm, task) > view.value(other, task) for other in others),
        *(algorithm, *others),
    )


def at_least(algorithm: str, other: str) -> Test:
    """One algorithm's value is equal to or higher than another's."""
    return compares(lambda view, task: view.value(algorithm, task) >= view.value(other, task), algorithm, other)


def beats(winners: Iterable[str], losers: Iterable[str], *shown: str) -> Test:
    """Each winner is significantly better than each loser; shown: in this order."""
    pairs = [(winner, loser) for winner in winners for loser in losers]
    return compares(lambda view, task: all(view.beats(*pair, task) for pair in pairs), *shown)


def similar(*pairs: tuple[str, str]) -> Test:
    """The algorithms of each pair are similar."""
    names = [name for pair in pairs for name in pair]
    return compares(lambda view, task: all(view.similar(*pair, task) for pair in pairs), *names)


def competitive(algorithm: str, where: Iterable[str] = TASKS) -> Test:
    """An algorithm is competitive in these tasks, and not in others."""

    def test(view: View, task: str) -> tuple[bool, str]:
        best = max(view.values(task).values())
        figures = f"{algorithm.upper()} {view.value(algorithm, task):.2f}, best {best:.2f}"
        return view.competitive(algorithm, task) == (task in where), figures

    return test


def best(algorithm: str) -> Test:
    """An algorithm has the highest value of all."""

    def test(view: View, task: str) -> tuple[bool, str]:
        values = view.values(task)
        highest = max(values, key=lambda name: values[name])
        found = values[algorithm] == values[highest]
        return found, values_text(view, [algorithm] if found else [algorithm, highest], task)

    return test


def centralised_above(view: View, task: str) -> tuple[bool, str]:
    """The better of MAA2C and MAPPO is above IA2C and IPPO."""
    centralised, independent = ("maa2c", "mappo"), ("ia2c", "ippo")
    above, below = (max(view.value(name, task) for name in names) for names in (centralised, independent))
    return above > below, values_text(view, (*centralised, *independent), task)


def best_independent_competitive(view: View, task: str) -> tuple[bool, str]:
    """The best of the independent learners is competitive."""
    values = view.values(task)
    own = max(INDEPENDENT, key=lambda name: values[name])
    return view.competitive(own, task), f"{own.upper()} {values[own]:.2f}, best {max(values.values()):.2f}"


def both_improved(view: View, task: str) -> tuple[bool, str]:
    """MAA2C is significantly better than IA2C, and MAPPO than IPPO."""
    better = view.beats("maa2c", "ia2c", task) and view.beats("mappo", "ippo", task)
    return better, values_text(view, ("maa2c", "ia2c", "mappo", "ippo"), task)


def no_learning(view: View, task: str) -> tuple[bool, str]:
    """IQL, MADDPG, COMA, VDN and QMIX have less than a tenth of the best return."""
    highest, algorithms = max(view.values(task).values()), ("iql", "maddpg", "coma", "vdn", "qmix")
    low = all(view.value(name, task) < 0.1 * highest for name in algorithms)
    return low, f"{values_text(view, algorithms, task)}, best {highest:.2f}"


def maddpg_worst(view: View, task: str) -> tuple[bool, str]:
    """MADDPG is below all others but COMA."""
    values = view.values(task)
    lowest = min(value for name, value in values.items() if name not in ("maddpg", "coma"))
    return values["maddpg"] < lowest, f"MADDPG {values['maddpg']:.2f}, lowest other {lowest:.2f}"


def maddpg_low(view: View, task: str) -> tuple[bool, str]:
    """MADDPG has less than half of the best return."""
    highest, own = max(view.values(task).values()), view.value("maddpg", task)
    return own < highest / 2, f"MADDPG {own:.2f}, best {highest:.2f}"


def coma_lowest(view: View, task: str) -> tuple[bool, str]:
    """COMA is one of the two lowest."""
    values = view.values(task)
    lower = sum(value < values["coma"] for value in values.values())
    return lower < 2 and values["coma"] < max(values.values()), f"COMA {values['coma']:.2f}, lower ones: {lower}"


def decomposition_matches(view: View, task: str) -> tuple[bool, str]:
    """VDN or QMIX is the best, or not significantly different from it."""
    values = view.values(task)
    highest = max(values, key=lambda name: values[name])
    own = max(("vdn", "qmix"), key=lambda name: values[name])
    matches = values[own] == values[highest] or view.same(own, highest, task)
    return matches, values_text(view, dict.fromkeys((own, highest)), task)


def decomposition_not_below_iql(view: View, task: str) -> tuple[bool, str]:
    """The better of VDN and QMIX is not below IQL."""
    own = max(view.value("vdn", task), view.value("qmix", task))
    return own >= view.value("iql", task), values_text(view, ("vdn", "qmix", "iql"), task)


def sharing_helps(view: View, task: str) -> tuple[bool, str]:
    """Most algorithms are better with sharing."""
    better = sum(view.value(name, task, True) > view.value(name, task, False) for name in ALGORITHMS)
    return better > len(ALGORITHMS) / 2, f"{better} of 9 algorithms"


# --- tests of one family ---
def of_family(name: str) -> list[str]:
    """The tasks of a family."""
    return [task for task in TASKS if family(task) == name]


def higher_on_average(algorithm: str, other: str, metric: str, lower_in: str = "") -> Test:
    """One algorithm's mean normalised value over a family is above another's; in the family `lower_in`, below."""

    def test(view: View, name: str) -> tuple[bool, str]:
        tasks = of_family(name)
        one, two = (
            sum(view.normalised(each, task, metric) for task in tasks) / len(tasks) for each in (algorithm, other)
        )
        return one < two if name == lower_in else one > two, f"{algorithm.upper()} {one:.2f}, {other.upper()} {two:.2f}"

    return test


def competitive_only(algorithm: str, where: str, in_one_task: bool = False) -> Test:
    """An algorithm is competitive in tasks (or one task) of one family, and in no other family."""

    def test(view: View, name: str) -> tuple[bool, str]:
        found = [task for task in of_family(name) if view.competitive(algorithm, task)]
        as_claimed = (len(found) == 1 if in_one_task else bool(found)) if name == where else not found
        return as_claimed, ", ".join(found)

    return test


def means_with_and_without(view: View, tasks: Iterable[str]) -> tuple[float, float]:
    """The means of the normalised maximum returns with and without sharing; normalised over both. Tasks on which all
    returns are equal do not count; where there are no others, both means are 0."""
    shared, alone = [], []
    for task in tasks:
        values = {each: [view.value(name, task, each) for name in ALGORITHMS] for each in (True, False)}
        low, high = min(values[True] + values[False]), max(values[True] + values[False])
        if high > low:
            shared += [(value - low) / (high - low) for value in values[True]]
            alone += [(value - low) / (high - low) for value in values[False]]
    return sum(shared) / max(len(shared), 1), sum(alone) / max(len(alone), 1)


def sharing_improves(view: View, name: str) -> tuple[bool, str]:
    """The mean is higher with sharing; in the matrix games it is not."""
    shared, alone = means_with_and_without(view, of_family(name))
    return (shared <= alone) if name == "matrix" else (shared > alone), f"{shared:.2f} with, {alone:.2f} without"


# --- claims that compare tasks or families ---
def vdn_qmix_mpe(view: View) -> Verdict:
    """By the mean difference of the normalised maxima."""
    apart = {}
    for name in ("mpe", "smac", "lbf", "rware"):
        gaps = [abs(view.normalised("vdn", task) - view.normalised("qmix", task)) for task in of_family(name)]
        apart[name] = sum(gaps) / len(gaps)
    figures = ", ".join(f"{name} {gap:.2f}" for name, gap in apart.items())
    return Verdict(HOLDS if apart["mpe"] == max(apart.values()) else FAILS, figures)


def sharing_sparse(view: View) -> Verdict:
    """In LBF."""
    large, small = means_with_and_without(view, LARGE_LBF), means_with_and_without(view, SMALL_LBF)
    gains = large[0] - large[1], small[0] - small[1]
    figures = "gains of {:.2f} on 15x15, {:.2f} on 8x8 and 10x10".format(*gains)
    return Verdict(HOLDS if gains[0] > gains[1] else FAILS, figures)


def sharing_rware(view: View) -> Verdict:
    """In RWARE."""
    means = {task: means_with_and_without(view, [task]) for task in RWARE}
    gains = {task: shared - alone for task, (shared, alone) in means.items()}
    simple = gains.pop("rware-tiny-4p")
    figures = ", ".join(f"{task} {gain:.2f}" for task, gain in gains.items())
    verdict = HOLDS if min(gains.values()) > simple else FAILS
    return Verdict(verdict, f"gains: {figures}, rware-tiny-4p {simple:.2f}")


def on(tasks: Iterable[str], test: Test, needed: float = 1.0, unit: str = "tasks") -> Callable[[View], Verdict]:
    """A claim that a test holds on tasks or families; see `among`."""
    return lambda view: among(view, tasks, test, needed, unit)


# By section, what the paper says, and whether it holds in a set of results
SECTIONS: dict[str, dict[str, Callable[[View], Verdict]]] = {
    "5.1": {
        "IQL performs significantly worse than IA2C and IPPO in Speaker-Listener and in all RWARE tasks.": on(
            [SPEAKER_LISTENER, *RWARE], beats(["ia2c", "ippo"], ["iql"], *INDEPENDENT)
        ),
        "IQL is effective (here: competitive) in all LBF tasks but the three with the largest grids.": on(
            LBF, competitive("iql", SMALL_LBF)
        ),
        "IQL achieves the best performance of all algorithms in 3s_vs_5z.": on(["smac-3s_vs_5z"], best("iql")),
        "IQL performs competitively in the other SMAC tasks.": on(
            [task for task in SMAC if task != "smac-3s_vs_5z"], competitive("iql")
        ),
        "IA2C performs similarly to IPPO in the majority of tasks.": on(TASKS, similar(("ia2c", "ippo")), MAJORITY),
        "IA2C performs competitively compared to all algorithms with centralised training (in most tasks).": on(
            TASKS, competitive("ia2c"), MAJORITY
        ),
        "IA2C achieves higher returns than IQL in all but two SMAC tasks.": on(SMAC, higher("ia2c", "iql"), 3 / 5),
        "IA2C significantly outperforms COMA and MADDPG in the majority of the tasks.": on(
            TASKS, beats(["ia2c"], ["coma", "maddpg"], "ia2c", "coma", "maddpg"), MAJORITY
        ),
        "IPPO in general performs competitively in all tasks (in the vast majority).": on(
            TASKS, competitive("ippo"), VAST_MAJORITY
        ),
        (
            "On average over training, IPPO achieves higher normalised returns than IA2C in MPE, SMAC and RWARE, "
            "lower in LBF."
        ): on(
            FAMILIES_BUT_MATRIX, higher_on_average("ippo", "ia2c", "average_return", lower_in="lbf"), unit="families"
        ),
        "IPPO outperforms MAA2C in the RWARE tasks.": on(RWARE, higher("ippo", "maa2c")),
        "IPPO in general performs worse than MAPPO (outside the matrix games, where both are equal).": on(
            NOT_MATRIX, higher("mappo", "ippo"), MAJORITY
        ),
    },
    "5.2": {
        (
            "Centralised critics are valuable (the better of MAA2C and MAPPO is above IA2C and IPPO) in "
            "Speaker-Listener and the harder SMAC tasks."
        ): on([SPEAKER_LISTENER, *HARD_SMAC], centralised_above),
        "Independent learning is competitive in the fully observable tasks of MPE and LBF (the majority of them).": on(
            FULLY_OBSERVABLE, best_independent_competitive, MAJORITY
        ),
        "In most RWARE tasks MAA2C and MAPPO significantly improve upon IA2C and IPPO.": on(
            RWARE, both_improved, MAJORITY
        ),
        "IQL, MADDPG, COMA, VDN and QMIX do not exhibit any learning in RWARE.": on(RWARE, no_learning),
        "MADDPG performs worse than all other algorithms except COMA in the majority of the tasks.": on(
            TASKS, maddpg_worst, MAJORITY
        ),
        "MADDPG performs competitively only in some MPE tasks (and in the matrix games).": on(
            FAMILIES_BUT_MATRIX, competitive_only("maddpg", "mpe"), unit="families"
        ),
        "MADDPG exhibits very low returns (less than half of the best) in LBF and RWARE (most of the tasks).": on(
            [*LBF, *RWARE], maddpg_low, MAJORITY
        ),
        "COMA exhibits one of the lowest performances (one of the two lowest) in most tasks.": on(
            TASKS, coma_lowest, MAJORITY
        ),
        "COMA performs competitively only in one SMAC task (and in the matrix games).": on(
            FAMILIES_BUT_MATRIX, competitive_only("coma", "smac", in_one_task=True), unit="families"
        ),
        "In Speaker-Listener, COMA fails to find the local optimum with a return of about -17.": on(
            [SPEAKER_LISTENER], compares(lambda view, task: view.value("coma", task) < -17, "coma")
        ),
        "MAA2C performs competitively in the majority of the tasks.": on(TASKS, competitive("maa2c"), MAJORITY),
        "MAA2C achieves slightly higher returns than MAPPO in MPE and LBF (the mean of the normalised maxima).": on(
            ("mpe", "lbf"), higher_on_average("maa2c", "mappo", "max_return"), unit="families"
        ),
        "MAA2C achieves significantly lower returns than MAPPO in most SMAC and RWARE tasks.": on(
            [*SMAC, *RWARE], beats(["mappo"], ["maa2c"], "mappo", "maa2c"), MAJORITY
        ),
        "MAPPO achieves high returns (is competitive) in the vast majority of tasks.": on(
            TASKS, competitive("mappo"), VAST_MAJORITY
        ),
        "MAPPO's returns in RWARE exceed those of all other algorithms.": on(RWARE, best("mappo")),
        "Except in RWARE, VDN or QMIX outperforms or matches the best other algorithm in the majority of tasks.": on(
            (*MATRIX, *MPE, *SMAC, *LBF), decomposition_matches, MAJORITY
        ),
        "VDN and QMIX perform similarly in most SMAC tasks and across LBF (most of the tasks of both).": on(
            [*SMAC, *LBF], similar(("vdn", "qmix")), MAJORITY
        ),
        "VDN and QMIX differ most in MPE (the mean difference of normalised maxima by family).": vdn_qmix_mpe,
        "QMIX achieves consistently high returns (is competitive) across almost all tasks.": on(
            TASKS, competitive("qmix"), VAST_MAJORITY
        ),
    },
    "5.3": {
        "In all environments except the matrix games, parameter sharing improves the normalised maximum returns.": on(
            PAPER_FAMILIES, sharing_improves, unit="families"
        ),
        "Sharing improves most algorithms in Speaker-Listener and Tag.": on(
            (SPEAKER_LISTENER, "mpe-tag"), sharing_helps
        ),
        "Sharing improves the returns (of most algorithms) in the harder SMAC tasks.": on(HARD_SMAC, sharing_helps),
        "In LBF, sharing helps more in larger grids, where the reward is sparser.": sharing_sparse,
        "In RWARE, sharing helps more with fewer agents, or in a larger warehouse, than in tiny-4p.": sharing_rware,
    },
    "6": {
        "IA2C and IPPO achieve higher returns than IQL in the majority of the tasks (outside the matrix games).": on(
            NOT_MATRIX,
            compares(
                lambda view, task: view.value("iql", task) < min(view.value("ia2c", task), view.value("ippo", task)),
                *INDEPENDENT,
            ),
            MAJORITY,
        ),
        "MAA2C achieves equal or higher returns than IA2C in the majority of the tasks.": on(
            TASKS, at_least("maa2c", "ia2c"), MAJORITY
        ),
        "MAA2C is significantly better than IA2C in the RWARE tasks with four agents.": on(
            [task for task in RWARE if "4p" in task], beats(["maa2c"], ["ia2c"], "maa2c", "ia2c")
        ),
        "MAA2C and IA2C are similar in RWARE tiny-2p.": on(["rware-tiny-2p"], similar(("maa2c", "ia2c"))),
        "IA2C and MAA2C, IPPO and MAPPO have similar returns in fully observable tasks (most of MPE and LBF).": on(
            FULLY_OBSERVABLE, similar(("ia2c", "maa2c"), ("ippo", "mappo")), MAJORITY
        ),
        "Value decomposition improves upon IQL across most tasks (the better of VDN and QMIX is not below IQL).": on(
            TASKS, decomposition_not_below_iql, MAJORITY
        ),
        "QMIX is better than VDN in Speaker-Listener and Tag.": on(
            (SPEAKER_LISTENER, "mpe-tag"), higher("qmix", "vdn")
        ),
        "QMIX is not above VDN in most LBF tasks.": on(LBF, at_least("vdn", "qmix"), MAJORITY),
        "VDN and QMIX are significantly worse than IA2C, IPPO, MAA2C and MAPPO in RWARE.": on(
            RWARE, beats(POLICY_GRADIENT, ["vdn", "qmix"], "vdn", "qmix", *POLICY_GRADIENT)
        ),
    },
}
CLAIMS = [(place, sentence, holds) for place, claims in SECTIONS.items() for sentence, holds in claims.items()]


def judge(cells: pd.DataFrame) -> list[Verdict]:
    """The verdict on each of CLAIMS in these cells."""
    verdicts = []
    view = View(cells)
    for _, _, function in CLAIMS:
        view.few_seeds = False
        try:
            verdict = function(view)
        except NotMeasured:
            verdict = Verdict(UNKNOWN, "")
        if view.few_seeds and verdict.figures:
            verdict = Verdict(verdict.verdict, f"{verdict.figures}; some from fewer than five seeds")
        verdicts.append(verdict)
    return verdicts
