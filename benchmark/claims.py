"""What the paper's sections 5 and 6 claim, judged by a set of results: a selection of sentences, one a line of
benchmark/paper/claims.csv.

    place        the section
    sentence     what the paper says; in brackets how it is read here
    tasks        sets (`SETS`) and tasks; with a minus without them; "families ..." goes family by family
    needed       on how many of them the expression must hold: all, majority (more than half), three quarters or a
                 number; "code" where the last column names a function of this module
    metric       what an algorithm's name stands for, such as max_return; with parameter sharing
    expression   comparisons, arithmetic, and, or, not, if, and these names and functions (`Scope`)

    iql, ia2c, ...                    the algorithm's value; in a family the mean of its scaled values
    best                              the highest value of the nine
    lbf, large_lbf, ...               whether the task, or the family, is in this set
    scaled(a)                         the value on a scale from the task's worst to its best algorithm
    lower(a)                          how many algorithms are below it
    competitive(a)                    within 1 % of the best, or at least 0.8 on that scale, or not significantly
                                      different from the best
    competitive(a, b, ...)            the same among these algorithms only
    similar(a, b)                     less than a tenth of the scale apart, or not significantly different
    significantly_above(a, b, ...)    higher than each of the others, and significantly so
    matches_best(a)                   the best, or not significantly different from it
    competitive_tasks(a)              on how many tasks of the family it is competitive
    improved                          how many algorithms are higher with parameter sharing than without
    shared, alone                     the mean scaled value with and without sharing, in a task or in all of a family
    gain, gain_in(lbf)                shared less alone, here or in another set
    apart(a, b), apart(a, b, mpe)     how far they are apart on the scale, the mean over the family or another set

"Significantly" is a two-sided Student t-test at 0.05, as the paper's asterisks. It needs two seeds, and where it finds
no difference, five: fewer could only mean that there are too few. A maximum that lies before training is the luck of
random networks; the average over training takes its place.

The verdict is holds, does not hold or not measured: decided as soon as what is missing cannot change it. Then each cell
with fewer than five seeds is completed to five, `DRAWS` times: the mean of all seeds is drawn from what our seeds say
of it, and the missing seeds around it, with the standard deviation that `agreement.spread` has. If more than one of
twenty of these tables gives another verdict, it is too close to call.

The same expressions judge the paper's own tables, since not every sentence agrees with them.
"""

import ast
import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from types import CodeType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmark.agreement import spread
from benchmark.store import (
    ALGORITHMS,
    INDEPENDENT,
    PAPER,
    PAPER_FAMILIES,
    PAPER_SEEDS,
    SHARED,
    SHARING,
    family,
    paper_cells,
)
from benchmark.tables import same_mean

HOLDS, FAILS, CLOSE, UNKNOWN = "holds", "does not hold", "too close to call", "not measured"
DRAWS = 1000
TURNED = 0.05  # in more than this share of the draws: too close to call
MOST_SHOWN = 4

TASKS = tuple(dict.fromkeys(paper_cells()["task"]))
SETS = {"all": TASKS} | {name: tuple(task for task in TASKS if family(task) == name) for name in PAPER_FAMILIES}
SETS["hard_smac"] = ("smac-corridor", "smac-MMM2")
SETS["large_lbf"] = tuple(task for task in SETS["lbf"] if "15x15" in task)
SETS["small_lbf"] = tuple(task for task in SETS["lbf"] if "15x15" not in task)
SETS["tiny_4p"] = ("rware-tiny-4p",)
SETS["fully_observable"] = (
    *("mpe-spread", "mpe-adversary", "mpe-tag"),
    *(task for task in SETS["lbf"] if "2s" not in task),
)

# The maxima of the paper's tables that lie before training. They are those of our runs, whose networks began alike.
UNTRAINED = {("max_return", SHARED, "matrix-climbing", name) for name in ("iql", "vdn", "qmix")} | {
    ("max_return", INDEPENDENT, f"matrix-penalty-{k}", name) for k in (25, 50, 75, 100) for name in ("vdn", "qmix")
}

Key = tuple[str, str, str, str]  # metric, sharing, the paper's task, algorithm


class NotMeasured(Exception):
    """A claim needs a result that is not there."""


class Cell(NamedTuple):
    """A value of a table, with its interval of 2 s / sqrt(n) and the number of seeds n."""

    value: float
    interval: float
    seeds: int


@dataclass(frozen=True)
class Verdict:
    """holds, does not hold, too close to call or not measured, and what is behind it.

    outcomes: by task or family, whether the expression holds there; None where it is not measured.
    rests_on: the cells that carry it, and what one seed more of each would cost; empty where all have five seeds.
    """

    verdict: str
    figures: str
    outcomes: dict[str, bool | None] = field(default_factory=dict)
    rests_on: str = ""


# --- what claims look at ---
def one_game(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells of one game for each of the paper's tasks, so that no comparison mixes two: of that which more
    algorithms were run on, the paper's own or the one that stands in for it; the paper's own, where it is the same."""
    games = cells.groupby(["metric", "sharing", "paper_task", "task"])["algorithm"].nunique().reset_index(name="number")
    games["own"] = games["task"] == games["paper_task"]
    chosen = games.sort_values(["number", "own"]).groupby(["metric", "sharing", "paper_task"]).tail(1)
    return cells.merge(chosen[["metric", "sharing", "paper_task", "task"]])


@dataclass(frozen=True)
class View:
    """The cells of a set of results, as claims look at them."""

    cells: dict[Key, Cell]

    @classmethod
    def of(cls, cells: pd.DataFrame) -> "View":
        """Cells in the form of `measures.our_cells` or `store.paper_cells`."""
        if "paper_task" not in cells:
            keys = pd.MultiIndex.from_frame(cells[["metric", "sharing", "task", "algorithm"]])
            cells = cells.assign(paper_task=cells["task"], other_budget=False, at_start=keys.isin(UNTRAINED))
        rows = one_game(cells[~cells["other_budget"]])
        keys = [*rows[["metric", "sharing", "paper_task", "algorithm"]].itertuples(index=False, name=None)]
        found = dict(zip(keys, map(Cell, rows["mean"], rows["interval"], rows["seeds"])))
        untrained = [key for key, at_start in zip(keys, rows["at_start"]) if at_start and key[0] == "max_return"]
        return cls(found | {key: found["average_return", *key[1:]] for key in untrained})

    def cell(self, metric: str, sharing: str, task: str, algorithm: str) -> Cell:
        """One cell. Raises NotMeasured."""
        try:
            return self.cells[metric, sharing, task, algorithm]
        except KeyError:
            raise NotMeasured from None

    def values(self, metric: str, sharing: str, task: str) -> dict[str, float]:
        """All nine algorithms' values. Raises NotMeasured."""
        return {name: self.cell(metric, sharing, task, name).value for name in ALGORITHMS}


def position(value: float, values: Iterable[float]) -> float:
    """A value on a scale from the lowest to the highest of these; 1 where all are equal."""
    low, high = min(values), max(values)
    return (value - low) / (high - low) if high > low else 1.0


@dataclass(frozen=True)
class Scope:
    """What the names and functions of an expression mean in one task, or in one family."""

    view: View
    place: str
    metric: str

    def at(self, task: str) -> "Scope":
        """The scope of one of its tasks."""
        return Scope(self.view, task, self.metric)

    def cell(self, algorithm: str) -> Cell:
        """An algorithm's cell."""
        return self.view.cell(self.metric, SHARED, self.place, algorithm)

    def values(self) -> dict[str, float]:
        """All nine algorithms' values."""
        return self.view.values(self.metric, SHARED, self.place)

    def value(self, algorithm: str) -> float:
        """An algorithm's value; in a family the mean of its scaled values."""
        if self.place not in PAPER_FAMILIES:
            return self.cell(algorithm).value
        return float(np.mean([self.at(task).scaled(algorithm) for task in SETS[self.place]]))

    def __getitem__(self, name: str) -> Any:
        """What a name of an expression stands for."""
        if name in ALGORITHMS:
            return self.value(name)
        if name in SETS:
            return self.place == name or self.place in SETS[name]
        return OF_NUMBERS[name] if name in OF_NUMBERS else getattr(self, name)

    # --- names and functions, as the head of this module defines them ---
    @property
    def best(self) -> float:
        return max(self.values().values())

    @property
    def improved(self) -> int:
        pairs = [
            [self.view.cell(self.metric, sharing, self.place, name).value for sharing in SHARING.values()]
            for name in ALGORITHMS
        ]
        return sum(with_sharing > without for with_sharing, without in pairs)

    @property
    def shared(self) -> float:
        return means_with_and_without(self.view, SETS.get(self.place, (self.place,)))[0]

    @property
    def alone(self) -> float:
        return means_with_and_without(self.view, SETS.get(self.place, (self.place,)))[1]

    @property
    def gain(self) -> float:
        return self.shared - self.alone

    def gain_in(self, place: str) -> float:
        return self.at(place).gain

    def apart(self, algorithm: str, other: str, place: str = "") -> float:
        scopes = [self.at(task) for task in SETS[place or self.place]]
        return float(np.mean([abs(scope.scaled(algorithm) - scope.scaled(other)) for scope in scopes]))

    def scaled(self, algorithm: str) -> float:
        return position(self.cell(algorithm).value, self.values().values())

    def lower(self, algorithm: str) -> int:
        own = self.cell(algorithm).value
        return sum(value < own for value in self.values().values())

    def competitive(self, algorithm: str, *others: str) -> bool:
        own, values = self.cell(algorithm), self.values()
        if others:
            values = {name: value for name, value in values.items() if name in (algorithm, *others)}
        highest = max(values, key=lambda name: values[name])
        near = own.value >= values[highest] - 0.01 * abs(values[highest])
        if near or position(own.value, values.values()) >= 0.8:
            return True
        return self.different(own, self.cell(highest)) is False

    def similar(self, algorithm: str, other: str) -> bool:
        if abs(self.scaled(algorithm) - self.scaled(other)) < 0.1:
            return True
        return not self.decided(self.cell(algorithm), self.cell(other))

    def significantly_above(self, algorithm: str, *others: str) -> bool:
        own = self.cell(algorithm)
        return all(own.value > self.cell(other).value and self.decided(own, self.cell(other)) for other in others)

    def matches_best(self, algorithm: str) -> bool:
        own, values = self.cell(algorithm), self.values()
        highest = max(values, key=lambda name: values[name])
        return own.value == values[highest] or not self.decided(own, self.cell(highest))

    def competitive_tasks(self, algorithm: str) -> int:
        return sum(self.at(task).competitive(algorithm) for task in SETS[self.place])

    def different(self, one: Cell, two: Cell) -> bool | None:
        """Whether two cells are significantly different; None where their seeds are too few to say."""
        fewest = min(one.seeds, two.seeds)
        if fewest < 2:
            return None
        if not same_mean(*one, *two):
            return True
        return False if fewest >= PAPER_SEEDS else None

    def decided(self, one: Cell, two: Cell) -> bool:
        """The same. Raises NotMeasured where the seeds are too few."""
        found = self.different(one, two)
        if found is None:
            raise NotMeasured
        return found


# --- expressions ---
NAMES = ("best", "improved", "shared", "alone", "gain")
OF_NUMBERS = {"max": max, "min": min, "abs": abs}
OF_ALGORITHMS = {
    *("scaled", "lower", "competitive", "similar", "significantly_above", "matches_best", "competitive_tasks"),
    *("gain_in", "apart"),
}
BOTH_SHARINGS = {"improved", "shared", "alone", "gain"}
OF_ALL_NINE = {*NAMES, *OF_ALGORITHMS} - {"significantly_above"}


@cache
def compiled(expression: str) -> CodeType:
    """An expression as `eval` takes it with a `Scope`. What stands in the brackets of a function of `OF_ALGORITHMS`
    are names, not values."""
    tree = ast.parse(expression, mode="eval")
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        if ast.unparse(call.func) in OF_ALGORITHMS:
            call.args = [ast.copy_location(ast.Constant(ast.unparse(name)), name) for name in call.args]
    return compile(tree, expression, "eval")


# --- claims ---
@dataclass(frozen=True)
class Claim:
    """A line of benchmark/paper/claims.csv."""

    place: str
    sentence: str
    tasks: str
    needed: str
    metric: str
    expression: str

    @cached_property
    def places(self) -> tuple[str, ...]:
        """The tasks, or the families."""
        words = self.tasks.split()
        if words[0] == "families":
            return tuple(words[1:])
        found: dict[str, None] = {}
        for word in words:
            name = word.removeprefix("-")
            tasks = SETS.get(name, (name,))
            if word == name:
                found |= dict.fromkeys(tasks)
            else:
                found = {task: None for task in found if task not in tasks}
        return tuple(found)

    @cached_property
    def named(self) -> list[str]:
        """The words in the expression, in order, each once."""
        return list(dict.fromkeys(re.findall("[a-z][a-z0-9_]*", self.expression)))

    def enough(self) -> int:
        """On how many tasks or families it must hold."""
        number = len(self.places)
        by_name = {"all": number, "majority": number // 2 + 1, "three quarters": math.ceil(0.75 * number)}
        return by_name[self.needed] if self.needed in by_name else int(self.needed)

    def cells(self) -> Iterator[Key]:
        """The cells that the claim looks at."""
        code, family_by_family = self.needed == "code", self.tasks.startswith("families")
        named = set() if code else {*self.named}
        alone = self.expression.startswith("sharing") if code else BOTH_SHARINGS & named
        if code or family_by_family or OF_ALL_NINE & named:
            algorithms: Iterable[str] = ALGORITHMS
        else:
            algorithms = [name for name in ALGORITHMS if name in named]
        for place in (*self.places, *(name for name in self.named if name in SETS)):
            for task in SETS.get(place, (place,)):
                for sharing in SHARING.values() if alone else (SHARED,):
                    yield from ((self.metric, sharing, task, name) for name in algorithms)

    def judge(self, view: View) -> Verdict:
        """By these cells as they are."""
        if self.needed == "code":
            try:
                return CODE[self.expression](view)
            except NotMeasured:
                return Verdict(UNKNOWN, "")
        outcomes: dict[str, bool | None] = {}
        for place in self.places:
            scope: Any = Scope(view, place, self.metric)
            try:
                outcomes[place] = bool(eval(compiled(self.expression), {}, scope))
            except NotMeasured:
                outcomes[place] = None
        return Verdict(verdict_of(outcomes, self.enough()), "", outcomes)

    def text(self, view: View, outcomes: dict[str, bool | None]) -> str:
        """The figures behind the verdict."""
        missing = [*outcomes.values()].count(None)
        if not outcomes or missing == len(outcomes):
            return ""
        words = "families" if self.tasks.startswith("families") else "tasks"
        yes, no = ([place for place, holds in outcomes.items() if holds is which] for which in (True, False))
        parts = [f"{len(yes)} of {len(outcomes)} {words}" + (f", {missing} not measured" if missing else "")]
        if yes and len(outcomes) <= MOST_SHOWN:
            parts.append(f"yes: {', '.join(self.values_text(view, place) for place in yes)}")
        if no:
            shown = [self.values_text(view, place) for place in no[:MOST_SHOWN]]
            parts.append(f"no: {', '.join(shown)}" + (", ..." if len(no) > MOST_SHOWN else ""))
        return "; ".join(parts)

    def values_text(self, view: View, place: str) -> str:
        """The values of one task or family that the expression names."""
        scope, parts = Scope(view, place, self.metric), []
        if "competitive_tasks" in self.named:
            algorithm = next(name for name in self.named if name in ALGORITHMS)
            tasks = [task for task in SETS[place] if scope.at(task).competitive(algorithm)]
            return f"{place} ({', '.join(tasks) or 'none'})"
        for name in self.named:
            if name in ALGORITHMS:
                parts.append(f"{name.upper()} {scope[name]:.2f}")
            elif name in NAMES:
                parts.append(f"{name} {scope[name]:{'d' if name == 'improved' else '.2f'}}")
        if {"competitive", "matches_best", "scaled"} & {*self.named} and place not in PAPER_FAMILIES:
            parts.append(f"best {scope.best:.2f}")
        return f"{place} ({', '.join(parts)})"


def verdict_of(outcomes: dict[str, bool | None], enough: int) -> str:
    """Whether the expression holds on enough tasks, as soon as those that are not measured cannot change it."""
    number = Counter(outcomes.values())
    return HOLDS if number[True] >= enough else FAILS if number[True] + number[None] < enough else UNKNOWN


# --- a claim that compares pairs of algorithm and task with each other ---
def means_with_and_without(view: View, tasks: Iterable[str]) -> tuple[float, float]:
    """The means of the normalised maximum returns with and without sharing; normalised over both. Tasks on which all
    returns are equal do not count; where there are no others, both means are 0."""
    means = []
    for task in tasks:
        values = np.array([[*view.values("max_return", sharing, task).values()] for sharing in SHARING.values()])
        if np.ptp(values):
            means.append((values.mean(axis=1) - values.min()) / np.ptp(values))
    shared, alone = np.mean(means, axis=0) if means else (0.0, 0.0)
    return shared, alone


def sharing_significant(view: View) -> Verdict:
    """Three pairs of algorithm and task at least."""
    found, missing = [], 0
    for task in TASKS:
        for name in ALGORITHMS:
            try:
                scope = Scope(view, task, "max_return")
                one, two = (view.cell("max_return", sharing, task, name) for sharing in SHARING.values())
                if one.value > two.value and scope.decided(one, two):
                    found.append(f"{name.upper()} on {task} ({one.value:.2f}, {two.value:.2f} without)")
            except NotMeasured:
                missing += 1
    shown = ", ".join(found[:MOST_SHOWN]) + (", ..." if len(found) > MOST_SHOWN else "")
    pairs = len(TASKS) * len(ALGORITHMS)
    if missing == pairs:
        raise NotMeasured
    figures = f"{len(found)} of {pairs} pairs" + (f", {missing} not measured" if missing else "")
    verdict = HOLDS if len(found) >= 3 else UNKNOWN if len(found) + missing >= 3 else FAILS
    return Verdict(verdict, f"{figures}: {shown}" if found else figures)


CODE = {"sharing_significant": sharing_significant}
with open(PAPER / "claims.csv", encoding="utf-8", newline="") as claims_file:
    CLAIMS = [Claim(**row) for row in csv.DictReader(claims_file)]


# --- verdicts ---
def completed(view: View, paper: View) -> list[View]:
    """`DRAWS` tables in which each cell that the paper has, too, has at least five seeds."""
    drawn: dict[Key, list[Cell]] = {}
    for key, cell in view.cells.items():
        rng = np.random.default_rng(list("/".join(key).encode()))  # new results elsewhere change nothing here
        missing = PAPER_SEEDS - cell.seeds
        if missing <= 0 or key not in paper.cells:
            continue
        deviation = float(spread(cell.interval, cell.seeds, paper.cells[key].interval))
        mean = rng.normal(cell.value, deviation / np.sqrt(cell.seeds), DRAWS)
        seeds = rng.normal(mean[:, None], deviation, (DRAWS, missing))
        theirs = seeds.mean(axis=1)
        whole = (cell.seeds * cell.value + missing * theirs) / PAPER_SEEDS
        squares = ((seeds - theirs[:, None]) ** 2).sum(axis=1)
        squares += cell.seeds * missing / PAPER_SEEDS * (cell.value - theirs) ** 2
        if cell.seeds > 1:
            squares += (cell.seeds - 1) * (cell.interval * np.sqrt(cell.seeds) / 2) ** 2
        intervals = 2 * np.sqrt(squares / (PAPER_SEEDS - 1)) / np.sqrt(PAPER_SEEDS)
        drawn[key] = [Cell(*each, PAPER_SEEDS) for each in zip(whole.tolist(), intervals.tolist())]
    return [View(view.cells | {key: cells[draw] for key, cells in drawn.items()}) for draw in range(DRAWS)]


def judge(cells: pd.DataFrame, hours: dict[tuple[str, str, str], float] | None = None) -> list[Verdict]:
    """The verdict on each of CLAIMS in these cells.

    hours: CPU hours of a run by sharing, the paper's task and algorithm, to say what one seed more would cost.
    """
    view = View.of(cells)
    few = {key for key, cell in view.cells.items() if cell.seeds < PAPER_SEEDS}
    tables = completed(view, View.of(paper_cells())) if few else []
    return [one_verdict(claim, view, tables, few, hours or {}) for claim in CLAIMS]


def one_verdict(
    claim: Claim, view: View, tables: list[View], few: set[Key], hours: dict[tuple[str, str, str], float]
) -> Verdict:
    """The verdict on one claim; tables: `completed`; few: the cells with fewer than five seeds."""
    found = claim.judge(view)
    found = replace(found, figures=found.figures or claim.text(view, found.outcomes))
    needed = set(claim.cells())
    carrying = needed & few
    if found.verdict == UNKNOWN:
        absent = sum(key not in view.cells for key in needed)
        missing = cells_text("needs more seeds: ", shown(claim, view, carrying), hours)
        return replace(found, rests_on=f"missing cells: {absent}" if absent else missing)
    if not carrying:
        return found
    drawn = [claim.judge(table) for table in tables]
    stays = float(np.mean([each.verdict == found.verdict for each in drawn]))
    if stays >= 1 - TURNED:
        return replace(found, rests_on=cells_text("", shown(claim, view, carrying), hours))
    turning = {
        place
        for place, holds in found.outcomes.items()
        if np.mean([each.outcomes[place] is not holds for each in drawn]) > TURNED
    }
    tasks = {task for place in turning for task in SETS.get(place, (place,))}
    deciding = shown(claim, view, {key for key in carrying if key[2] in tasks} or carrying)
    words = f"{found.verdict} as it is, and in {100 * stays:.0f} % of the completed tables; "
    return replace(found, verdict=CLOSE, rests_on=cells_text(words, deciding, hours))


def shown(claim: Claim, view: View, cells: set[Key]) -> set[Key]:
    """Those of these cells that are of an algorithm that the claim names, or of the best on their task; all of them,
    where the claim is code."""
    if claim.needed == "code":
        return cells
    highest: dict[tuple[str, ...], float] = {}
    for key, cell in view.cells.items():
        highest[key[:3]] = max(cell.value, highest.get(key[:3], -math.inf))
    return {key for key in cells if key[3] in claim.named or view.cells[key].value == highest[key[:3]]} or cells


def cells_text(words: str, cells: set[Key], hours: dict[tuple[str, str, str], float]) -> str:
    """How many cells with fewer than five seeds there are, on which tasks, and what one seed more of each costs."""
    tasks = [task for task in TASKS if any(key[2] == task for key in cells)]
    shown = ", ".join(tasks[:MOST_SHOWN]) + (", ..." if len(tasks) > MOST_SHOWN else "")
    cost = sum(hours.get(key[1:], 0.0) for key in cells)
    price = f"; one seed more of each: {cost:.1f} CPU hours" if cost else ""
    return f"{words}{len(cells)} cell{'s' * (len(cells) > 1)} with fewer than five seeds ({shown}){price}"
