"""What the paper's sections 5 and 6 claim, judged by a set of results: a selection of sentences, one a line of
benchmark/paper/claims.csv.

    place        the section
    sentence     what the paper says; in brackets how it is read here
    tasks        sets (`SETS`) and tasks; with a minus without them; "families ..." goes family by family, "pairs ..."
                 algorithm by algorithm on each task
    needed       on how many of them the expression must hold: all, majority (more than half), three quarters or a
                 number
    metric       what an algorithm's name stands for, such as max_return; with parameter sharing
    expression   comparisons, arithmetic, and, or, not, if, max, min, abs, and these names and functions; there is
                 nothing else that it can say (`compiled`)

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
    significantly_improved            whether the pair's algorithm is, and significantly so
    shared, alone                     the mean scaled value with and without sharing, in a task or in all of a family
    gain, gain_in(lbf)                shared less alone, here or in another set
    apart(a, b), apart(a, b, mpe)     how far they are apart on the scale, the mean over the family or another set

"Significantly" is a two-sided Student t-test at 0.05, as the paper's asterisks. Returns that differ by no more than
0.1 % of the most that the game can give are ties. A maximum that lies before training is the luck of random networks;
the average over training takes its place.

The verdict. Each cell with fewer than five seeds is completed to five, `DRAWS` times: the mean of all seeds is drawn
from what our seeds say of it, and the missing seeds around it, with the standard deviation that `agreement.spread` has,
and none beyond the bounds of what the game can return. The claim holds, or does not, if it does so in 95 % of these
tables, and by more than twice the standard error of this share. Else it is too close to call; or not measured, if cells
that do not exist could still decide it.

The same expressions judge the paper's own tables, since not every sentence agrees with them.
"""

import ast
import csv
import functools
import math
import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import t

import envs
from benchmark.agreement import LEVEL, METRICS, spread
from benchmark.store import (
    ALGORITHMS,
    INDEPENDENT,
    PAPER,
    PAPER_FAMILIES,
    PAPER_SEEDS,
    SHARED,
    SHARING,
    best_return,
    family,
    paper_cells,
)
from envs import InputError

HOLDS, FAILS, CLOSE, UNKNOWN = "holds", "does not hold", "too close to call", "not measured"
DRAWS = 12_000  # so that twice the standard error of a share is below 1 %
SURE = 0.95
TIE = 0.001  # of the most that the game can return
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
Hours = dict[tuple[str, str, str], float]  # of a run, by sharing, the paper's task and algorithm
Array = NDArray[Any]  # [draw] unless it says more


# --- what claims look at ---
class Cell(NamedTuple):
    """A value of a table, with its interval of 2 s / sqrt(n) and the number of seeds n; in each of some tables."""

    value: Array
    interval: Array
    seeds: int


@dataclass(frozen=True)
class View:
    """The cells of a set of results in one or more tables, as claims look at them.

    games: for each of the paper's tasks the game that the cells are of: itself, or one that stands in for it.
    ties: whether values that lie close together are ties.
    """

    cells: dict[Key, Cell]
    games: dict[str, str]
    draws: int = 1
    ties: bool = True

    @classmethod
    def of(cls, cells: pd.DataFrame) -> "View":
        """Cells in the form of `measures.our_cells` or `store.paper_cells`, in one table as they are."""
        if "paper_task" not in cells:
            keys = pd.MultiIndex.from_frame(cells[["metric", "sharing", "task", "algorithm"]])
            cells = cells.assign(paper_task=cells["task"], other_budget=False, at_start=keys.isin(UNTRAINED))
        rows = one_game(cells[~cells["other_budget"]])
        keys = [*rows[["metric", "sharing", "paper_task", "algorithm"]].itertuples(index=False, name=None)]
        values, intervals = (rows[name].to_numpy(float)[:, None] for name in ("mean", "interval"))
        found = dict(zip(keys, map(Cell, values, intervals, rows["seeds"])))
        untrained = [key for key, at_start in zip(keys, rows["at_start"]) if at_start and key[0] == "max_return"]
        games = dict(zip(rows["paper_task"], rows["task"]))
        return cls(found | {key: found["average_return", *key[1:]] for key in untrained}, games)

    def without_stand_ins(self) -> "View":
        """Without the cells of games that stand in for the paper's."""
        return replace(self, cells={key: cell for key, cell in self.cells.items() if self.games[key[2]] == key[2]})

    def cell(self, key: Key) -> Cell:
        """A cell; one of NaN where there is none."""
        return self.cells.get(key, self.nothing)

    @functools.cached_property
    def nothing(self) -> Cell:
        """A cell that was not measured."""
        return Cell(np.full(self.draws, np.nan), np.full(self.draws, np.nan), PAPER_SEEDS)

    def tie(self, task: str) -> float:
        """How far two returns may differ and be a tie; 0 in a family."""
        best = np.inf if task in PAPER_FAMILIES else best_return(task)
        return TIE * abs(best) if self.ties and np.isfinite(best) else 0.0


def one_game(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells of one game for each of the paper's tasks, so that no comparison mixes two: of that which more
    algorithms were run on, the paper's own or the one that stands in for it; the paper's own, where it is the same."""
    games = cells.groupby(["paper_task", "task"])["algorithm"].nunique().reset_index(name="number")
    games["own"] = games["task"] == games["paper_task"]
    chosen = games.sort_values(["number", "own"]).groupby("paper_task").tail(1)
    return cells.merge(chosen[["paper_task", "task"]])


def completed(view: View, paper: View) -> View:
    """`DRAWS` tables in which each cell that the paper has, too, has at least five seeds."""
    cells: dict[Key, Cell] = {}
    for key, (value, interval, seeds) in view.cells.items():
        missing = PAPER_SEEDS - seeds
        if missing <= 0 or key not in paper.cells or key[0] not in METRICS:
            continue
        rng = np.random.default_rng(list("/".join(key).encode()))  # new results elsewhere change nothing here
        deviation = float(spread(interval, seeds, paper.cells[key].interval)[0])
        mean = rng.normal(value, deviation / np.sqrt(seeds), DRAWS)
        drawn = rng.normal(mean, deviation, (missing, DRAWS)).clip(*envs.task(key[2]).returns)
        theirs = drawn.mean(axis=0)
        whole = (seeds * value + missing * theirs) / PAPER_SEEDS
        squares = ((drawn - theirs) ** 2).sum(axis=0) + seeds * missing / PAPER_SEEDS * (value - theirs) ** 2
        if seeds > 1:
            squares += (seeds - 1) * (interval * np.sqrt(seeds) / 2) ** 2
        cells[key] = Cell(whole, 2 * np.sqrt(squares / (PAPER_SEEDS - 1) / PAPER_SEEDS), PAPER_SEEDS)
    for key, (value, interval, seeds) in view.cells.items():
        cells.setdefault(key, Cell(np.broadcast_to(value, DRAWS), np.broadcast_to(interval, DRAWS), seeds))
    return replace(view, cells=cells, draws=DRAWS)


@functools.cache
def critical(freedom: int) -> float:
    """Of Student's t, two-sided."""
    return float(t.ppf(1 - LEVEL / 2, freedom))


def position(value: Array, low: Array, high: Array, tie: float) -> Array:
    """A value on a scale from the lowest to the highest of some values; 1 where these are ties."""
    flat = high - low <= tie
    return np.where(flat, 1.0, (value - low) / np.where(flat, 1.0, high - low))


@dataclass(frozen=True)
class Scope:
    """What the names and functions of an expression mean in one task, in one family, or for one algorithm on one task.

    asked: the cells that were looked at.
    """

    view: View
    place: str
    metric: str
    algorithm: str = ""
    asked: set[Key] = field(default_factory=set)

    def at(self, task: str) -> "Scope":
        """The scope of one of its tasks."""
        return replace(self, place=task)

    def tasks(self) -> tuple[str, ...]:
        """The family's, or the one task."""
        return SETS.get(self.place, (self.place,))

    @property
    def tie(self) -> float:
        return self.view.tie(self.place)

    def cell(self, algorithm: str, sharing: str = SHARED) -> Cell:
        """An algorithm's cell."""
        key = self.metric, sharing, self.place, algorithm
        self.asked.add(key)
        return self.view.cell(key)

    def values(self, names: Iterable[str] = ALGORITHMS, sharing: str = SHARED) -> Array:
        """Algorithms' values, [algorithm, draw]."""
        return np.stack([self.cell(name, sharing).value for name in names])

    def value(self, algorithm: str) -> Array:
        """An algorithm's value; in a family the mean of its scaled values."""
        if self.place not in PAPER_FAMILIES:
            return self.cell(algorithm).value
        return np.mean([self.at(task).scaled(algorithm) for task in self.tasks()], axis=0)

    def different(self, one: Cell, two: Cell) -> Array:
        """Whether two cells are significantly different, and no tie."""
        distance, freedom = np.abs(one.value - two.value), one.seeds + two.seeds - 2
        squares = sum((cell.seeds - 1) * cell.seeds * (cell.interval / 2) ** 2 for cell in (one, two))
        error = np.sqrt(squares / freedom * (1 / one.seeds + 1 / two.seeds))
        return (distance > critical(freedom) * error) & (distance > max(self.tie, 1e-9))

    def like_the_highest(self, algorithm: str, names: tuple[str, ...]) -> Array:
        """Whether it is not significantly different from the highest of these."""
        own, highest = self.cell(algorithm), self.values(names).argmax(axis=0)
        where = {name: highest == k for k, name in enumerate(names)}
        alike = [there & ~self.different(own, self.cell(name)) for name, there in where.items() if there.any()]
        return np.any(alike, axis=0)

    def sharing_means(self) -> Array:
        """[sharing, draw]: the means of the normalised values with and without sharing; normalised over both. Tasks on
        which all values are ties do not count; where there are no others, both means are 0."""
        total, number = np.zeros((2, self.view.draws)), np.zeros(self.view.draws)
        for scope in map(self.at, self.tasks()):
            values = np.stack([scope.values(sharing=sharing) for sharing in SHARING.values()])
            low, high = values.min(axis=(0, 1)), values.max(axis=(0, 1))
            counts = ~(high - low <= scope.tie)
            total += np.where(counts, position(values, low, high, scope.tie).mean(axis=1), 0.0)
            number += counts
        return total / np.maximum(number, 1)

    # --- names and functions, as the head of this module defines them ---
    def best(self) -> Array:
        return self.values().max(axis=0)

    def improved(self) -> Array:
        return (self.values() > self.values(sharing=INDEPENDENT) + self.tie).sum(axis=0)

    def significantly_improved(self) -> Array:
        one, two = self.cell(self.algorithm), self.cell(self.algorithm, INDEPENDENT)
        return (one.value > two.value) & self.different(one, two)

    def shared(self) -> Array:
        return self.sharing_means()[0]

    def alone(self) -> Array:
        return self.sharing_means()[1]

    def gain(self) -> Array:
        return np.subtract(*self.sharing_means())

    def gain_in(self, place: str) -> Array:
        return self.at(place).gain()

    def apart(self, algorithm: str, other: str, place: str = "") -> Array:
        scopes = [self.at(task) for task in SETS[place or self.place]]
        return np.mean([np.abs(scope.scaled(algorithm) - scope.scaled(other)) for scope in scopes], axis=0)

    def scaled(self, algorithm: str) -> Array:
        values = self.values()
        return position(self.cell(algorithm).value, values.min(axis=0), values.max(axis=0), self.tie)

    def lower(self, algorithm: str) -> Array:
        return (self.values() < self.cell(algorithm).value - self.tie).sum(axis=0)

    def competitive(self, algorithm: str, *others: str) -> Array:
        names = (algorithm, *others) if others else ALGORITHMS
        own, values = self.cell(algorithm).value, self.values(names)
        low, high = values.min(axis=0), values.max(axis=0)
        near = own >= high - np.maximum(0.01 * np.abs(high), self.tie)
        return near | (position(own, low, high, self.tie) >= 0.8) | self.like_the_highest(algorithm, names)

    def similar(self, algorithm: str, other: str) -> Array:
        near = np.abs(self.scaled(algorithm) - self.scaled(other)) < 0.1
        return near | ~self.different(self.cell(algorithm), self.cell(other))

    def significantly_above(self, algorithm: str, *others: str) -> Array:
        own, cells = self.cell(algorithm), map(self.cell, others)
        return np.all([(own.value > cell.value) & self.different(own, cell) for cell in cells], axis=0)

    def matches_best(self, algorithm: str) -> Array:
        is_best = self.cell(algorithm).value >= self.best() - self.tie
        return is_best | self.like_the_highest(algorithm, ALGORITHMS)

    def competitive_tasks(self, algorithm: str) -> Array:
        return np.sum([self.at(task).competitive(algorithm) for task in self.tasks()], axis=0)


# --- expressions ---
Part = Callable[[Scope], Any]
NAMES: dict[str, Part] = {
    f.__name__: f
    for f in (Scope.best, Scope.improved, Scope.significantly_improved, Scope.shared, Scope.alone, Scope.gain)
}
FUNCTIONS: dict[str, Callable[..., Array]] = {
    f.__name__: f
    for f in (
        *(Scope.gain_in, Scope.apart, Scope.scaled, Scope.lower, Scope.competitive, Scope.similar),
        *(Scope.significantly_above, Scope.matches_best, Scope.competitive_tasks),
    )
}
OF_NUMBERS: dict[str, Callable[..., Any]] = {
    "max": lambda *values: functools.reduce(np.maximum, values),
    "min": lambda *values: functools.reduce(np.minimum, values),
    "abs": np.abs,
}
OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.USub: operator.neg, ast.Not: np.logical_not, ast.And: np.logical_and, ast.Or: np.logical_or},
}
# Comparisons of two values that are ties if they lie this near to each other.
COMPARISONS: dict[type[ast.AST], Callable[[Any, Any, float], Any]] = {
    ast.Lt: lambda one, two, tie: one < two - tie,
    ast.Gt: lambda one, two, tie: one > two + tie,
    ast.LtE: lambda one, two, tie: one <= two + tie,
    ast.GtE: lambda one, two, tie: one >= two - tie,
    ast.Eq: lambda one, two, tie: np.abs(one * 1.0 - two) <= tie,
    ast.NotEq: lambda one, two, tie: np.abs(one * 1.0 - two) > tie,
}


@functools.cache
def compiled(expression: str) -> Part:
    """An expression as a function of a scope. InputError for anything but what the head of this module lists."""
    return part(ast.parse(expression, mode="eval").body)


def part(node: ast.expr) -> Part:
    """A part of an expression as a function of a scope."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return lambda scope: value
        case ast.Name(id=name) if name in ALGORITHMS:
            return lambda scope: scope.value(name)
        case ast.Name(id=name) if name in NAMES:
            return NAMES[name]
        case ast.Name(id=name) if name in SETS:
            return lambda scope: scope.place == name or scope.place in SETS[name]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            names = [arg.id for arg in args if isinstance(arg, ast.Name) and arg.id in {*ALGORITHMS, *SETS}]
            if len(names) == len(args) > 0:
                return lambda scope: FUNCTIONS[name](scope, *names)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in OF_NUMBERS and args:
            return applied(OF_NUMBERS[name], args)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            return applied(OPERATORS[type(op)], [left, right])
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            return applied(OPERATORS[type(op)], [operand])
        case ast.BoolOp(op=op, values=values):
            return applied(lambda *each: functools.reduce(OPERATORS[type(op)], each), values)
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
            one, two, compare, of_returns = part(left), part(right), COMPARISONS[type(op)], is_of_returns(node)
            return lambda scope: compare(one(scope), two(scope), scope.tie if of_returns else 0.0)
        case ast.IfExp(test=ast.Name(id=name) as test, body=body, orelse=orelse) if name in SETS:
            condition, yes, no = part(test), part(body), part(orelse)
            return lambda scope: yes(scope) if condition(scope) else no(scope)
    raise InputError(f"a claim cannot say {ast.unparse(node)}")


def applied(function: Callable[..., Any], arguments: list[ast.expr]) -> Part:
    """A function of the values of these parts."""
    parts = [*map(part, arguments)]
    return lambda scope: function(*(each(scope) for each in parts))


def is_of_returns(node: ast.Compare) -> bool:
    """Whether it compares returns, in which there are ties, and nothing that was made of them, such as a number."""
    names = {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
    return names <= {*ALGORITHMS, "best", *OF_NUMBERS}


# --- claims ---
@dataclass(frozen=True)
class Verdict:
    """holds, does not hold, too close to call or not measured, and what is behind it.

    share, open: of the completed tables those in which it holds, and those in which cells that do not exist decide.
    error: twice the standard error of the share. outcomes: by task, family or pair the share of the tables in which the
    expression holds there; None where it is not measured. rests_on: the cells that carry it, and what one seed more of
    each would cost; empty where all have five seeds. alone: the verdict without the games that stand in for the
    paper's; empty where it looks at none. strict: the verdict if there were no ties.
    """

    verdict: str
    share: float
    open: float
    error: float
    outcomes: dict[str, float | None]
    figures: str = ""
    rests_on: str = ""
    alone: str = ""
    strict: str = ""

    @property
    def shares(self) -> str:
        """Share and error in percent, and what is open."""
        open_tables = f"; open in {100 * self.open:.1f} %" if self.open else ""
        return f"{100 * self.share:.1f} ± {100 * self.error:.1f} %{open_tables}"


@dataclass(frozen=True)
class Claim:
    """A line of benchmark/paper/claims.csv."""

    place: str
    sentence: str
    tasks: str
    needed: str
    metric: str
    expression: str

    @property
    def kind(self) -> str:
        """What it goes by: tasks, families or pairs."""
        word = self.tasks.split()[0]
        return word if word in ("families", "pairs") else "tasks"

    @functools.cached_property
    def places(self) -> tuple[tuple[str, str], ...]:
        """The tasks or the families, each with the pair's algorithm or nothing."""
        words = self.tasks.removeprefix(self.kind).split()
        if self.kind == "families":
            return tuple((name, "") for name in words)
        found: dict[str, None] = {}
        for word in words:
            tasks = SETS.get(word.removeprefix("-"), (word.removeprefix("-"),))
            if word.startswith("-"):
                found = {task: None for task in found if task not in tasks}
            else:
                found |= dict.fromkeys(tasks)
        return tuple((task, name) for task in found for name in (ALGORITHMS if self.kind == "pairs" else ("",)))

    @functools.cached_property
    def named(self) -> list[str]:
        """The words in the expression, in order, each once."""
        return list(dict.fromkeys(re.findall("[a-z][a-z0-9_]*", self.expression)))

    def enough(self) -> int:
        """On how many tasks, families or pairs it must hold."""
        number = len(self.places)
        by_name = {"all": number, "majority": number // 2 + 1, "three quarters": math.ceil(0.75 * number)}
        return by_name[self.needed] if self.needed in by_name else int(self.needed)

    def judge(self, view: View) -> tuple[Verdict, dict[str, set[Key]]]:
        """The verdict by these tables, and by place the cells that it looked at."""
        outcomes: dict[str, Array | None] = {}
        asked: dict[str, set[Key]] = {}
        for place, algorithm in self.places:
            scope = Scope(view, place, self.metric, algorithm)
            holds = np.broadcast_to(compiled(self.expression)(scope), view.draws)
            name = f"{algorithm} {place}".strip()
            asked[name] = scope.asked
            outcomes[name] = holds if scope.asked <= view.cells.keys() else None
        return verdict_of(outcomes, self.enough(), view.draws), asked

    def text(self, view: View, tables: View, outcomes: dict[str, float | None]) -> str:
        """The figures behind the verdict; view: the table as it is, whose values are shown; tables: completed. Yes is
        what holds in most of these."""
        missing = [*outcomes.values()].count(None)
        if missing == len(outcomes):
            return ""
        yes, no = (
            [place for place, share in outcomes.items() if share is not None and (share >= 0.5) is which]
            for which in (True, False)
        )
        parts = [f"{len(yes)} of {len(outcomes)} {self.kind}" + (f", {missing} not measured" if missing else "")]
        if yes and (len(outcomes) <= MOST_SHOWN or self.kind == "pairs"):
            parts.append(f"yes: {self.listed(view, tables, yes)}")
        if no and self.kind != "pairs":
            parts.append(f"no: {self.listed(view, tables, no)}")
        return "; ".join(parts)

    def listed(self, view: View, tables: View, places: list[str]) -> str:
        """A few places with their values."""
        shown = ", ".join(self.values_text(view, tables, place) for place in places[:MOST_SHOWN])
        return shown + (", ..." if len(places) > MOST_SHOWN else "")

    def values_text(self, view: View, tables: View, place: str) -> str:
        """The values of one task, family or pair that the expression names."""
        algorithm, _, task = place.rpartition(" ")
        scope, parts, title = Scope(view, task, self.metric, algorithm), [], game(view, task)
        if "competitive_tasks" in self.named:
            named = next(name for name in self.named if name in ALGORITHMS)
            scopes = [Scope(tables, each, self.metric) for each in scope.tasks()]
            tasks = [game(view, each.place) for each in scopes if each.competitive(named).mean() >= 0.5]
            return f"{title} ({', '.join(tasks) or 'none'})"
        if algorithm:
            one, two = (scope.cell(algorithm, sharing).value[0] for sharing in SHARING.values())
            return f"{algorithm.upper()} on {title} ({one:.2f}, {two:.2f} without)"
        for name in self.named:
            if name in ALGORITHMS:
                parts.append(f"{name.upper()} {scope.value(name)[0]:.2f}")
            elif name in NAMES and name != "best":
                parts.append(f"{name} {NAMES[name](scope)[0]:{'d' if name == 'improved' else '.2f'}}")
        if {"best", "competitive", "matches_best", "scaled"} & {*self.named} and place not in PAPER_FAMILIES:
            parts.append(f"best {scope.best()[0]:.2f}")
        return f"{title} ({', '.join(parts)})"


def game(view: View, place: str) -> str:
    """The name of the game that the cells of a task are of; of a family of which some are stand-ins, that they are."""
    if any(view.games.get(task, task) != task for task in SETS.get(place, ()) if place in PAPER_FAMILIES):
        return f"the stand-ins of {PAPER_FAMILIES[place]}"
    return view.games.get(place, place)


def verdict_of(outcomes: dict[str, Array | None], enough: int, draws: int) -> Verdict:
    """Whether the expression holds in enough places, as the tables say; outcomes: by place, None where it is not
    measured."""
    known = [holds for holds in outcomes.values() if holds is not None]
    yes, missing = np.sum(known, axis=0) if known else np.zeros(1), len(outcomes) - len(known)
    share, failing = float(np.mean(yes >= enough)), float(np.mean(yes + missing < enough))
    undecided = float(np.mean((yes < enough) & (yes + missing >= enough)))

    def error(of: float) -> float:
        return 2 * math.sqrt(of * (1 - of) / draws)

    if share - error(share) >= SURE:
        verdict = HOLDS
    elif failing - error(failing) >= SURE:
        verdict = FAILS
    else:
        verdict = UNKNOWN if undecided and max(share, failing) + undecided >= SURE else CLOSE
    shares = {place: None if holds is None else float(np.mean(holds)) for place, holds in outcomes.items()}
    return Verdict(verdict, share, undecided, error(share), shares)


with open(PAPER / "claims.csv", encoding="utf-8", newline="") as claims_file:
    CLAIMS = [Claim(**row) for row in csv.DictReader(claims_file)]


# --- verdicts ---
def judge(cells: pd.DataFrame, hours: Hours | None = None) -> list[Verdict]:
    """The verdict on each of CLAIMS in these cells. hours: to say what one seed more would cost."""
    view = View.of(cells)
    few = {key for key, cell in view.cells.items() if cell.seeds < PAPER_SEEDS}
    tables = completed(view, View.of(paper_cells())) if few else view
    return [one_verdict(claim, view, tables, few, hours or {}) for claim in CLAIMS]


def one_verdict(claim: Claim, view: View, tables: View, few: set[Key], hours: Hours) -> Verdict:
    """The verdict on one claim; view: as it is; tables: completed; few: the cells with fewer than five seeds."""
    found, asked = claim.judge(tables)
    cells = set().union(*asked.values())
    alone = ""
    if any(view.games.get(key[2], key[2]) != key[2] for key in cells):
        without = claim.judge(tables.without_stand_ins())[0]
        alone = f"{without.verdict}, {without.shares}"
    open_places = [place for place, share in found.outcomes.items() if share is not None and 0.05 < share < SURE]
    deciding = set().union(*(asked[place] for place in open_places)) & few or cells & few
    absent = len(cells - view.cells.keys())
    parts = [f"missing cells: {absent}"] if absent else []
    if deciding:
        parts.append(cells_text(view, shown(claim, view, deciding), hours))
    some = any(tables.tie(key[2]) for key in cells)
    strict = claim.judge(replace(tables, ties=False))[0].verdict if some else found.verdict
    figures = claim.text(view, tables, found.outcomes)
    return replace(found, figures=figures, rests_on="; ".join(parts), alone=alone, strict=strict)


def shown(claim: Claim, view: View, cells: set[Key]) -> set[Key]:
    """Those of these cells that are of an algorithm that the claim names, or of the best on their task; all of them,
    where it goes by pairs."""
    highest: dict[tuple[str, ...], float] = {}
    for key, cell in view.cells.items():
        highest[key[:3]] = max(cell.value[0], highest.get(key[:3], -math.inf))
    named = {key for key in cells if key[3] in claim.named or view.cells[key].value[0] == highest[key[:3]]}
    return cells if claim.kind == "pairs" else named or cells


def cells_text(view: View, cells: set[Key], hours: Hours) -> str:
    """How many cells with fewer than five seeds there are, on which tasks, and what one seed more of each costs."""
    tasks = [game(view, task) for task in TASKS if any(key[2] == task for key in cells)]
    shown = ", ".join(tasks[:MOST_SHOWN]) + (", ..." if len(tasks) > MOST_SHOWN else "")
    cost = sum(hours.get(key[1:], 0.0) for key in cells)
    price = f"; one seed more of each: {cost:.1f} CPU hours" if cost else ""
    return f"{len(cells)} cell{'s' * (len(cells) > 1)} with fewer than five seeds ({shown}){price}"
