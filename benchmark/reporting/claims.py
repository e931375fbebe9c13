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

from reporting.results import ALGORITHMS, PAPER_FAMILIES, PAPER_SEEDS, family, paper_returns
from reporting.tables import same_mean

HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "not measured yet"
TASKS = tuple(dict.fromkeys(paper_returns()["task"]))
MATRIX, MPE, SMAC, LBF, RWARE = (tuple(task for task in TASKS if family(task) == name) for name in PAPER_FAMILIES)
HARD_SMAC = ("smac-corridor", "smac-MMM2")
LARGE_LBF = ("lbf-15x15-3p-5f", "lbf-15x15-4p-3f", "lbf-15x15-4p-5f")
SMALL_LBF = tuple(task for task in LBF if task not in LARGE_LBF)
FULLY_OBSERVABLE = ("mpe-spread", "mpe-adversary", "mpe-tag", *(task for task in LBF if "2s" not in task))
NOT_MATRIX = tuple(task for task in TASKS if task not in MATRIX)
SPEAKER_LISTENER = "mpe-speaker-listener"
INDEPENDENT = ("iql", "ia2c", "ippo")
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


Test = Callable[[str], tuple[bool, str]]
CLAIMS: list[tuple[str, str, Callable[[View], Verdict]]] = []


def claim(place: str, sentence: str) -> Callable[[Callable[[View], Verdict]], Callable[[View], Verdict]]:
    """Adds a function to the table of claims, with where the paper says what."""

    def add(function: Callable[[View], Verdict]) -> Callable[[View], Verdict]:
        CLAIMS.append((place, sentence, function))
        return function

    return add


def among(tasks: Iterable[str], test: Test, needed: float = 1.0, unit: str = "tasks") -> Verdict:
    """Whether the test holds on enough of the tasks: all of them, or at least the needed share; MAJORITY is more than
    half. It is decided as soon as the tasks that are not measured cannot change it. The test gives its figures too."""
    tasks = list(tasks)
    enough = len(tasks) // 2 + 1 if needed == MAJORITY else math.ceil(needed * len(tasks))
    yes: list[str] = []
    no: list[str] = []
    missing: list[str] = []
    for task in tasks:
        try:
            holds, figures = test(task)
        except NotMeasured:
            missing.append(task)
        else:
            (yes if holds else no).append(f"{task} ({figures})" if figures else task)
    verdict = UNKNOWN
    if len(yes) >= enough:
        verdict = HOLDS
    elif len(yes) + len(missing) < enough:
        verdict = FAILS
    parts = [f"{len(yes)} of {len(tasks)} {unit}" + (f", {len(missing)} not measured" if missing else "")]
    if yes and len(tasks) <= MOST_SHOWN:
        parts.append(f"yes: {', '.join(yes)}")
    if no:
        parts.append(f"no: {', '.join(no[:MOST_SHOWN])}" + (", ..." if len(no) > MOST_SHOWN else ""))
    return Verdict(verdict, "; ".join(parts) if len(missing) < len(tasks) else "")


def against(view: View, algorithms: Iterable[str], task: str) -> str:
    """The algorithms' values on a task as text."""
    return ", ".join(f"{name.upper()} {view.value(name, task):.2f}" for name in algorithms)


def higher(view: View, algorithm: str, other: str) -> Test:
    """A test: one algorithm's value is higher than another's."""
    return lambda task: (
        view.value(algorithm, task) > view.value(other, task),
        against(view, (algorithm, other), task),
    )


def at_least(view: View, algorithm: str, other: str) -> Test:
    """A test: one algorithm's value is equal to or higher than another's."""
    return lambda task: (
        view.value(algorithm, task) >= view.value(other, task),
        against(view, (algorithm, other), task),
    )


@claim("5.1", "IQL performs significantly worse than IA2C and IPPO in Speaker-Listener and in all RWARE tasks.")
def iql_partially_observable(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        worse = all(view.beats(other, "iql", task) for other in ("ia2c", "ippo"))
        return worse, against(view, INDEPENDENT, task)

    return among([SPEAKER_LISTENER, *RWARE], test)


@claim("5.1", "IQL is effective (here: competitive) in all LBF tasks but the three with the largest grids.")
def iql_foraging(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        best = max(view.values(task).values())
        figures = f"IQL {view.value('iql', task):.2f}, best {best:.2f}"
        return view.competitive("iql", task) == (task in SMALL_LBF), figures

    return among(LBF, test)


@claim("5.1", "IQL achieves the best performance of all algorithms in 3s_vs_5z.")
def iql_smac(view: View) -> Verdict:
    return among(["smac-3s_vs_5z"], lambda task: best_of(view, task, ["iql"]))


@claim("5.1", "IQL performs competitively in the other SMAC tasks.")
def iql_other_smac(view: View) -> Verdict:
    others = [task for task in SMAC if task != "smac-3s_vs_5z"]
    return among(others, lambda task: competitive_text(view, "iql", task))


def best_of(view: View, task: str, algorithms: Iterable[str]) -> tuple[bool, str]:
    """Whether one of the algorithms has the highest value of all, and the figures."""
    values = view.values(task)
    best = max(values, key=lambda name: values[name])
    names = list(algorithms)
    found = max(values[name] for name in names) == values[best]
    return found, against(view, names if found else [*names, best], task)


@claim("5.1", "IA2C performs similarly to IPPO in the majority of tasks.")
def ia2c_ippo(view: View) -> Verdict:
    return among(
        TASKS, lambda task: (view.similar("ia2c", "ippo", task), against(view, ("ia2c", "ippo"), task)), MAJORITY
    )


@claim("5.1", "IA2C performs competitively compared to all algorithms with centralised training (in most tasks).")
def ia2c_competitive(view: View) -> Verdict:
    return among(TASKS, lambda task: competitive_text(view, "ia2c", task), MAJORITY)


@claim("5.1", "IA2C achieves higher returns than IQL in all but two SMAC tasks.")
def ia2c_iql(view: View) -> Verdict:
    return among(SMAC, higher(view, "ia2c", "iql"), 3 / 5)


@claim("5.1", "IA2C significantly outperforms COMA and MADDPG in the majority of the tasks.")
def ia2c_coma_maddpg(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        beaten = all(view.beats("ia2c", other, task) for other in ("coma", "maddpg"))
        return beaten, against(view, ("ia2c", "coma", "maddpg"), task)

    return among(TASKS, test, MAJORITY)


@claim("5.1", "IPPO in general performs competitively in all tasks (in the vast majority).")
def ippo_competitive(view: View) -> Verdict:
    return among(TASKS, lambda task: competitive_text(view, "ippo", task), VAST_MAJORITY)


@claim(
    "5.1",
    "On average over training, IPPO achieves higher normalised returns than IA2C in MPE, SMAC and RWARE, lower in LBF.",
)
def ippo_ia2c_on_average(view: View) -> Verdict:
    def mean(algorithm: str, tasks: tuple[str, ...]) -> float:
        return sum(view.normalised(algorithm, task, "average_return") for task in tasks) / len(tasks)

    def test(name: str) -> tuple[bool, str]:
        tasks = tuple(task for task in TASKS if family(task) == name)
        ippo, ia2c = mean("ippo", tasks), mean("ia2c", tasks)
        return (ippo < ia2c) if name == "lbf" else (ippo > ia2c), f"IPPO {ippo:.2f}, IA2C {ia2c:.2f}"

    return among(("mpe", "smac", "rware", "lbf"), test, unit="families")


@claim("5.1", "IPPO outperforms MAA2C in the RWARE tasks.")
def ippo_maa2c(view: View) -> Verdict:
    return among(RWARE, higher(view, "ippo", "maa2c"))


@claim("5.1", "IPPO in general performs worse than MAPPO (outside the matrix games, where both are equal).")
def ippo_mappo(view: View) -> Verdict:
    return among(NOT_MATRIX, higher(view, "mappo", "ippo"), MAJORITY)


@claim(
    "5.2",
    "Centralised critics are valuable (the better of MAA2C and MAPPO is above IA2C and IPPO) in Speaker-Listener "
    "and the harder SMAC tasks.",
)
def centralised_critics(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        centralised, independent = ("maa2c", "mappo"), ("ia2c", "ippo")
        best, other = (max(view.value(name, task) for name in names) for names in (centralised, independent))
        return best > other, against(view, (*centralised, *independent), task)

    return among([SPEAKER_LISTENER, *HARD_SMAC], test)


@claim(
    "5.2", "Independent learning is competitive in the fully observable tasks of MPE and LBF (the majority of them)."
)
def independent_learning(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        values = view.values(task)
        best = max(INDEPENDENT, key=lambda name: values[name])
        return view.competitive(best, task), f"{best.upper()} {values[best]:.2f}, best {max(values.values()):.2f}"

    return among(FULLY_OBSERVABLE, test, MAJORITY)


@claim("5.2", "In most RWARE tasks MAA2C and MAPPO significantly improve upon IA2C and IPPO.")
def centralised_in_rware(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        better = view.beats("maa2c", "ia2c", task) and view.beats("mappo", "ippo", task)
        return better, against(view, ("maa2c", "ia2c", "mappo", "ippo"), task)

    return among(RWARE, test, MAJORITY)


@claim("5.2", "IQL, MADDPG, COMA, VDN and QMIX do not exhibit any learning in RWARE.")
def no_learning_in_rware(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        best = max(view.values(task).values())
        algorithms = ("iql", "maddpg", "coma", "vdn", "qmix")
        low = all(view.value(name, task) < 0.1 * best for name in algorithms)
        return low, f"{against(view, algorithms, task)}, best {best:.2f}"

    return among(RWARE, test)


@claim("5.2", "MADDPG performs worse than all other algorithms except COMA in the majority of the tasks.")
def maddpg_worst(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        values = view.values(task)
        others = [value for name, value in values.items() if name not in ("maddpg", "coma")]
        return values["maddpg"] < min(others), f"MADDPG {values['maddpg']:.2f}, lowest other {min(others):.2f}"

    return among(TASKS, test, MAJORITY)


@claim("5.2", "MADDPG performs competitively only in some MPE tasks (and in the matrix games).")
def maddpg_competitive(view: View) -> Verdict:
    def test(name: str) -> tuple[bool, str]:
        found = competitive_in(view, "maddpg", name)
        return bool(found) == (name == "mpe"), ", ".join(found)

    return among(("mpe", "smac", "rware", "lbf"), test, unit="families")


def competitive_in(view: View, algorithm: str, name: str) -> list[str]:
    """The tasks of a family in which an algorithm is competitive."""
    return [task for task in TASKS if family(task) == name and view.competitive(algorithm, task)]


@claim("5.2", "MADDPG exhibits very low returns (less than half of the best) in LBF and RWARE (most of the tasks).")
def maddpg_low(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        best = max(view.values(task).values())
        return view.value("maddpg", task) < best / 2, f"MADDPG {view.value('maddpg', task):.2f}, best {best:.2f}"

    return among([*LBF, *RWARE], test, MAJORITY)


@claim("5.2", "COMA exhibits one of the lowest performances (one of the two lowest) in most tasks.")
def coma_lowest(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        values = view.values(task)
        lower = sum(value < values["coma"] for value in values.values())
        return lower < 2 and values["coma"] < max(values.values()), f"COMA {values['coma']:.2f}, lower ones: {lower}"

    return among(TASKS, test, MAJORITY)


@claim("5.2", "COMA performs competitively only in one SMAC task (and in the matrix games).")
def coma_competitive(view: View) -> Verdict:
    def test(name: str) -> tuple[bool, str]:
        found = competitive_in(view, "coma", name)
        return len(found) == (1 if name == "smac" else 0), ", ".join(found)

    return among(("mpe", "smac", "rware", "lbf"), test, unit="families")


@claim("5.2", "In Speaker-Listener, COMA fails to find the local optimum with a return of about -17.")
def coma_speaker_listener(view: View) -> Verdict:
    return among([SPEAKER_LISTENER], lambda task: (view.value("coma", task) < -17, against(view, ["coma"], task)))


@claim("5.2", "MAA2C performs competitively in the majority of the tasks.")
def maa2c_competitive(view: View) -> Verdict:
    return among(TASKS, lambda task: competitive_text(view, "maa2c", task), MAJORITY)


def competitive_text(view: View, algorithm: str, task: str) -> tuple[bool, str]:
    """Whether an algorithm is competitive, and the figures."""
    best = max(view.values(task).values())
    return view.competitive(algorithm, task), f"{algorithm.upper()} {view.value(algorithm, task):.2f}, best {best:.2f}"


@claim("5.2", "MAA2C achieves slightly higher returns than MAPPO in MPE and LBF (the mean of the normalised maxima).")
def maa2c_higher(view: View) -> Verdict:
    def test(name: str) -> tuple[bool, str]:
        tasks = [task for task in TASKS if family(task) == name]
        maa2c, mappo = (sum(view.normalised(each, task) for task in tasks) / len(tasks) for each in ("maa2c", "mappo"))
        return maa2c > mappo, f"MAA2C {maa2c:.2f}, MAPPO {mappo:.2f}"

    return among(("mpe", "lbf"), test, unit="families")


@claim("5.2", "MAA2C achieves significantly lower returns than MAPPO in most SMAC and RWARE tasks.")
def maa2c_lower(view: View) -> Verdict:
    test = beats_text(view, "mappo", "maa2c")
    return among([*SMAC, *RWARE], test, MAJORITY)


def beats_text(view: View, algorithm: str, other: str) -> Test:
    """A test: one algorithm is significantly better than another."""
    return lambda task: (view.beats(algorithm, other, task), against(view, (algorithm, other), task))


@claim("5.2", "MAPPO achieves high returns (is competitive) in the vast majority of tasks.")
def mappo_competitive(view: View) -> Verdict:
    return among(TASKS, lambda task: competitive_text(view, "mappo", task), VAST_MAJORITY)


@claim("5.2", "MAPPO's returns in RWARE exceed those of all other algorithms.")
def mappo_rware(view: View) -> Verdict:
    return among(RWARE, lambda task: best_of(view, task, ["mappo"]))


@claim("5.2", "Except in RWARE, VDN or QMIX outperforms or matches the best other algorithm in the majority of tasks.")
def decomposition_matches(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        values = view.values(task)
        best = max(values, key=lambda name: values[name])
        own = max(("vdn", "qmix"), key=lambda name: values[name])
        matches = values[own] == values[best] or view.same(own, best, task)
        return matches, against(view, dict.fromkeys((own, best)), task)

    return among((*MATRIX, *MPE, *SMAC, *LBF), test, MAJORITY)


@claim("5.2", "VDN and QMIX perform similarly in most SMAC tasks and across LBF (most of the tasks of both).")
def vdn_qmix_similar(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        return view.similar("vdn", "qmix", task), against(view, ("vdn", "qmix"), task)

    return among([*SMAC, *LBF], test, MAJORITY)


@claim("5.2", "VDN and QMIX differ most in MPE (the mean difference of normalised maxima by family).")
def vdn_qmix_mpe(view: View) -> Verdict:
    apart = {}
    for name, tasks in (("mpe", MPE), ("smac", SMAC), ("lbf", LBF), ("rware", RWARE)):
        gaps = [abs(view.normalised("vdn", task) - view.normalised("qmix", task)) for task in tasks]
        apart[name] = sum(gaps) / len(gaps)
    figures = ", ".join(f"{name} {gap:.2f}" for name, gap in apart.items())
    return Verdict(HOLDS if apart["mpe"] == max(apart.values()) else FAILS, figures)


@claim("5.2", "QMIX achieves consistently high returns (is competitive) across almost all tasks.")
def qmix_competitive(view: View) -> Verdict:
    return among(TASKS, lambda task: competitive_text(view, "qmix", task), VAST_MAJORITY)


@claim("5.3", "In all environments except the matrix games, parameter sharing improves the normalised maximum returns.")
def sharing_by_family(view: View) -> Verdict:
    def test(name: str) -> tuple[bool, str]:
        shared, alone = means_with_and_without(view, [task for task in TASKS if family(task) == name])
        return (shared <= alone) if name == "matrix" else (shared > alone), f"{shared:.2f} with, {alone:.2f} without"

    return among(PAPER_FAMILIES, test, unit="families")


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


def sharing_helps(view: View, task: str) -> tuple[bool, str]:
    """Whether most algorithms are better with sharing on a task."""
    better = sum(view.value(name, task, True) > view.value(name, task, False) for name in ALGORITHMS)
    return better > len(ALGORITHMS) / 2, f"{better} of 9 algorithms"


@claim("5.3", "Sharing improves most algorithms in Speaker-Listener and Tag.")
def sharing_mpe(view: View) -> Verdict:
    return among((SPEAKER_LISTENER, "mpe-tag"), lambda task: sharing_helps(view, task))


@claim("5.3", "Sharing improves the returns (of most algorithms) in the harder SMAC tasks.")
def sharing_smac(view: View) -> Verdict:
    return among(HARD_SMAC, lambda task: sharing_helps(view, task))


@claim("5.3", "In LBF, sharing helps more in larger grids, where the reward is sparser.")
def sharing_sparse(view: View) -> Verdict:
    large, small = means_with_and_without(view, LARGE_LBF), means_with_and_without(view, SMALL_LBF)
    gains = large[0] - large[1], small[0] - small[1]
    return Verdict(
        HOLDS if gains[0] > gains[1] else FAILS, "gains of {:.2f} on 15x15, {:.2f} on 8x8 and 10x10".format(*gains)
    )


@claim("5.3", "In RWARE, sharing helps more with fewer agents, or in a larger warehouse, than in tiny-4p.")
def sharing_rware(view: View) -> Verdict:
    gains = {}
    for task in RWARE:
        shared, alone = means_with_and_without(view, [task])
        gains[task] = shared - alone
    simple = gains.pop("rware-tiny-4p")
    figures = ", ".join(f"{task} {gain:.2f}" for task, gain in gains.items())
    verdict = HOLDS if min(gains.values()) > simple else FAILS
    return Verdict(verdict, f"gains: {figures}, rware-tiny-4p {simple:.2f}")


@claim("6", "IA2C and IPPO achieve higher returns than IQL in the majority of the tasks (outside the matrix games).")
def on_policy_independent(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        iql = view.value("iql", task)
        return all(view.value(name, task) > iql for name in ("ia2c", "ippo")), against(view, INDEPENDENT, task)

    return among(NOT_MATRIX, test, MAJORITY)


@claim("6", "MAA2C achieves equal or higher returns than IA2C in the majority of the tasks.")
def maa2c_ia2c(view: View) -> Verdict:
    return among(TASKS, at_least(view, "maa2c", "ia2c"), MAJORITY)


@claim("6", "MAA2C is significantly better than IA2C in the RWARE tasks with four agents.")
def maa2c_four_agents(view: View) -> Verdict:
    return among([task for task in RWARE if "4p" in task], beats_text(view, "maa2c", "ia2c"))


@claim("6", "MAA2C and IA2C are similar in RWARE tiny-2p.")
def maa2c_two_agents(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        return view.similar("maa2c", "ia2c", task), against(view, ("maa2c", "ia2c"), task)

    return among(["rware-tiny-2p"], test)


@claim("6", "IA2C and MAA2C, IPPO and MAPPO have similar returns in fully observable tasks (most of MPE and LBF).")
def same_information(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        pairs = (("ia2c", "maa2c"), ("ippo", "mappo"))
        return all(view.similar(*pair, task) for pair in pairs), against(view, (*pairs[0], *pairs[1]), task)

    return among(FULLY_OBSERVABLE, test, MAJORITY)


@claim("6", "Value decomposition improves upon IQL across most tasks (the better of VDN and QMIX is not below IQL).")
def decomposition_iql(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        best = max(view.value("vdn", task), view.value("qmix", task))
        return best >= view.value("iql", task), against(view, ("vdn", "qmix", "iql"), task)

    return among(TASKS, test, MAJORITY)


@claim("6", "QMIX is better than VDN in Speaker-Listener and Tag.")
def qmix_mpe(view: View) -> Verdict:
    return among((SPEAKER_LISTENER, "mpe-tag"), higher(view, "qmix", "vdn"))


@claim("6", "QMIX is not above VDN in most LBF tasks.")
def qmix_lbf(view: View) -> Verdict:
    return among(LBF, at_least(view, "vdn", "qmix"), MAJORITY)


@claim("6", "VDN and QMIX are significantly worse than IA2C, IPPO, MAA2C and MAPPO in RWARE.")
def decomposition_rware(view: View) -> Verdict:
    def test(task: str) -> tuple[bool, str]:
        policy_gradient = ("ia2c", "ippo", "maa2c", "mappo")
        worse = all(view.beats(one, other, task) for one in policy_gradient for other in ("vdn", "qmix"))
        return worse, against(view, ("vdn", "qmix", *policy_gradient), task)

    return among(RWARE, test)


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
