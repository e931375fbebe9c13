"""The benchmark's report, from benchmark/results/ and the paper's tables.

    python benchmark/report.py [--results benchmark/results] [--output benchmark] [--marl-eval <json>]

writes into the output folder

    RESULTS.md     tables, figures and claims
    figures/       the figures, PNG and SVG, and a hash of the results that they were drawn from
    tables.csv     the cells of all tables, ours and the paper's
    evaluations.csv.gz     every evaluation of every run, one row each; not in git, which each report would make larger

and, where the output is this folder, the short version into the repository's README.md, between two markers.
`--marl-eval` also writes the evaluations in marl-eval's JSON, for other programs.

    python benchmark/report.py --grid benchmark/searches/paper

prints the variants that a search has run (`benchmark/README.md`), the best first, and writes nothing.
"""

import argparse
import gzip
import hashlib
import itertools
import json
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmark import agreement, claims, measures, plan, plots, tables
from benchmark.measures import in_tables, our_cells
from benchmark.store import (
    ALGORITHMS,
    FAMILIES,
    HERE,
    KEY,
    PAPER_CPU_HOURS,
    PAPER_FAMILIES,
    PAPER_RUNS,
    PAPER_SEEDS,
    PAPER_SETTING,
    RESULTS,
    algorithm_order,
    has_older_rules,
    load,
    paper_cells,
    paper_task,
    speeds,
)
from envs import InputError, runs
from envs.runs import Parser, one_sentence

BEGIN = "<!-- results: begin (python benchmark/report.py writes what stands between these markers) -->"
END = "<!-- results: end -->"
SEEDS = HERE / "seeds.csv"
EVALUATION_COLUMNS = [
    *("task", "family", "algorithm", "sharing", "setting", "total_timesteps", "seed", "timestep"),
    *("return", "return_std", "episode_length", "cpu_seconds", "commit"),
]


class Report:
    """Everything that the report is made of."""

    def __init__(self, results: Path):
        self.evaluations = load(results)
        self.shown = in_tables(self.evaluations)
        self.against_own = in_tables(self.evaluations, own_opponent=True)
        self.ours, self.paper = our_cells(self.evaluations), paper_cells()
        committed = results.resolve() == RESULTS
        self.planned = plan.read_seeds(SEEDS) if committed else {}  # of one's own results nothing is planned here
        self.both = tables.compare(self.ours, self.paper, self.planned)
        self.compared = self.both[self.both["difference"].notna()]  # with the paper's
        self.counted = agreement.counted(self.compared)
        rows = zip(self.shown["task"], self.shown["sharing"])
        self.counted_planned = self.counted_of(self.shown["seed"] < [self.planned.get(row, np.inf) for row in rows])
        self.counted_first = self.counted_of(self.shown["seed"] == 0)
        self.normalised = measures.normalise(self.evaluations)
        self.hours = measures.cpu_hours(self.evaluations)
        self.speeds = speeds(results)
        self.digest = digest(results)

    def figures(self) -> dict[str, Callable[[], Figure]]:
        """What draws each figure that there are results for, by its name."""
        made: dict[str, Callable[[], Figure]] = {}
        shown = self.shown[~self.shown["task"].map(has_older_rules).astype(bool)]
        for family in FAMILIES:
            for sharing in plots.SHARING:
                if ((shown["family"] == family) & (shown["sharing"] == sharing)).any():
                    made[f"curves-{family}-{sharing}"] = partial(plots.learning_curves, shown, family, sharing)
        for sharing in plots.SHARING:
            if (self.normalised["sharing"] == sharing).any():
                made[f"normalised-{sharing}"] = partial(plots.normalised_curves, self.normalised, sharing)
                made[f"profiles-{sharing}"] = partial(plots.profiles, self.normalised, sharing)
        if len(measures.sharing_means(self.ours)):
            made["sharing"] = partial(plots.sharing_effect, self.ours, self.paper)
        if len(self.hours):
            made["cpu-hours"] = partial(plots.cpu_hours, self.hours)
        if len(self.speeds):
            made["speed"] = partial(plots.simulation_speed, self.speeds)
        return made

    def seeds_of_cells(self) -> pd.Series:
        """The seeds of each cell of the paper's tables that we have, by family, sharing, task and algorithm."""
        shown = self.shown[~self.shown["other_budget"] & self.shown["algorithm"].isin(ALGORITHMS)]
        shown = shown[shown["task"].map(paper_task).isin(self.paper["task"])]
        return shown.groupby(["family", "sharing", "task", "algorithm"])["seed"].nunique()

    def coverage(self) -> str:
        """How much of the paper's tables was run, and of what there is nothing."""
        cells = self.seeds_of_cells()
        stand_ins = cells[[paper_task(task) != task for task in cells.index.get_level_values("task")]]
        there = {(name, sharing) for name, sharing, _, _ in cells.index}
        nothing = []
        for sharing, words in plots.SHARING.items():
            absent = [title for name, title in PAPER_FAMILIES.items() if (name, sharing) not in there]
            nothing += [f"{words} of {', '.join(absent)}"] if absent else []
        counted = cells.clip(upper=PAPER_SEEDS)
        parts = [
            f"The paper's tables have {PAPER_RUNS // PAPER_SEEDS} cells of five runs each, {PAPER_RUNS:,} in all. Of "
            f"these cells {len(cells) - len(stand_ins)} were run here, with "
            f"{counted.sum() - counted[stand_ins.index].sum()} runs; {len(stand_ins)} more, with "
            f"{counted[stand_ins.index].sum()} runs, are of games that stand in for SMAC's."
        ]
        return " ".join([*parts, *([f"Nothing was run {'; '.join(nothing)}."] if nothing else [])])

    def coverage_table(self) -> str:
        """The same by family and sharing, with the number of seeds."""
        cells, body = self.seeds_of_cells(), []
        for (name, title), (sharing, words) in itertools.product(PAPER_FAMILIES.items(), plots.SHARING.items()):
            seeds = cells[[row[:2] == (name, sharing) for row in cells.index]]
            whole = len(claims.SETS[name]) * len(ALGORITHMS)
            stand_ins = any(paper_task(task) != task for _, _, task, _ in seeds.index)
            counts = ", ".join(f"{number} with {n}" for n, number in sorted(Counter(seeds).items()))
            body.append(
                [
                    "The stand-ins of " * stand_ins + f"{title}, {words}",
                    f"{len(seeds)} of {whole}",
                    f"{seeds.clip(upper=PAPER_SEEDS).sum()} of {whole * PAPER_SEEDS}",
                    counts or "-",
                ]
            )
        return tables.to_markdown(["", "cells", "runs", "cells by number of seeds"], body)

    def counted_of(self, chosen: Any) -> pd.DataFrame:
        """The counted cells, made of these rows of the evaluations that the tables show."""
        cells = our_cells(self.shown[chosen].drop(columns="other_budget"))
        return agreement.counted(tables.compare(cells[cells["metric"].isin(agreement.METRICS)], self.paper))

    def agreement(self) -> str:
        """How many of our values agree with the paper's: with seed 0 alone, with the planned seeds, with all."""
        if self.counted.empty:
            return "None of our values is of one of the paper's tasks with its budget and flags."

        def said(cells: pd.DataFrame, apart: bool = False) -> str:
            chosen = (cells["family"] != "matrix") & (apart | (cells["apart"] == ""))
            return agreement.numbers(cells.loc[chosen, "agrees"]) or "none"

        parts = [
            f"With seed 0 alone, {said(self.counted_first)} of our average and maximum returns agree with the paper's: "
            "they lie within the 95 % prediction interval of the difference, outside which chance puts one in twenty."
        ]
        if self.planned:
            parts += [
                f"With each cell cut to the seeds that are planned for its row, {said(self.counted_planned)} agree, "
                f"and with all seeds {said(self.counted)}.",
                "The last figure is too good: before there was a plan, cells that did not agree got more seeds until "
                f"they did.{self.incomplete_rows()}",
            ]
        elif (self.counted["seeds"] > 1).any():
            parts += [f"With all seeds {said(self.counted)} agree."]
        parts += [
            f"Not counted here are the matrix games, and {' and '.join(agreement.SET_APART)}, which were set apart "
            f"after their results were known; with these two, {said(self.counted_first, True)} agree with seed 0, and "
            f"{said(self.counted, True)} with all."
        ]
        return " ".join(parts)

    def incomplete_rows(self) -> str:
        """That some rows with several planned seeds have them only in cells that were chosen so."""
        rows = [row for row, seeds in self.planned.items() if seeds > 1 and not row[0].startswith("matrix")]
        there = self.shown.groupby(["task", "sharing", "algorithm"])["seed"].nunique()
        least = there.groupby(["task", "sharing"]).min()
        number = sum(least.get(row, 0) < self.planned[row] for row in rows)
        of_rows = f" {number} of the {len(rows)} rows with several planned seeds are not complete yet"
        return f"{of_rows}, so the second figure is too good, too." if number else ""

    def agreement_table(self) -> str:
        """How many of our values agree with the paper's, by family and sharing; and the test's false alarms."""
        if self.counted.empty:
            return ""
        corrected = agreement.without_bias(self.counted_planned, self.shown)
        which = "planned seeds" if self.planned else "all seeds"
        columns = [
            column
            for name in agreement.METRICS.values()
            for column in (f"{name}, seed 0", f"{name}, {which}", "placebo")
        ]
        families = agreement.by_family(self.counted_first, self.counted_planned, corrected, plots.SHARING)
        parts = [tables.to_markdown(["", *columns, f"maximum returns, {which}, corrected"], families)]
        alarms = [
            [str(seeds), *(f"{100 * agreement.false_alarms(seeds, interval):.1f} %" for interval in (1.0, 0.02))]
            for seeds in sorted(self.counted_planned["seeds"].unique())
        ]
        parts.append(
            tables.to_markdown(["our seeds", "false alarms", "false alarms where the paper prints ± 0.02"], alarms)
        )
        single = corrected[(corrected["seeds"] == 1) & (corrected["paper_interval"] > 0)]
        trivial = self.compared["metric"].isin(agreement.METRICS) & agreement.is_trivial(self.compared)
        words = [AGREEMENT_WORDS.format(left_out=trivial.sum())]
        if len(single):
            surplus = (single["bias"] / single["paper_interval"]).groupby(single["family"]).median()
            middle = ", ".join(f"{surplus[name]:.1f} in {FAMILIES[name]}" for name in FAMILIES if name in surplus)
            words.append(f"{MAXIMA_WORDS} Its median, in units of the paper's interval: {middle}.")
        return "\n\n".join([*parts, *map(fill, words)])

    def agreement_in_short(self) -> str:
        """A table of the average returns that agree, by family."""
        first, averages = (cells[cells["metric"] == "average_return"] for cells in (self.counted_first, self.counted))
        others = agreement.placebo(averages)
        families = {name: title for name, title in FAMILIES.items() if (averages["family"] == name).any()}

        def line(title: str, cells: pd.DataFrame, text: Callable[[pd.Series], str]) -> list[str]:
            return [title, *(text(cells.loc[cells["family"] == name, "agrees"]) for name in families)]

        lines = [
            line("ours that agree, seed 0 alone", first, agreement.numbers),
            line(f"ours that agree, {'planned' if self.planned else 'all'} seeds", averages, agreement.numbers),
            line("another algorithm's, in their place, that would", others, agreement.percent),
        ]
        return tables.to_markdown(["average returns", *families.values()], lines if families else [])

    def differences(self) -> str:
        """The cells that are outside the 95 % prediction interval, and what they are set apart as."""
        cells = self.compared[self.compared["difference"].abs() > 1]
        cells = cells[cells["metric"].isin(["average_return", "max_return", "max_win_rate"])]
        cells = cells.reindex(cells["difference"].abs().sort_values(ascending=False, kind="stable").index)
        cells = cells.assign(apart=agreement.set_apart(cells))
        header = ["table", "task", "algorithm", "sharing", "seeds", "ours", "paper", "difference", "set apart as"]
        body = [
            [
                tables.TITLES[cell.metric],
                f"{cell.task}{measures.beside(cell.task)}",
                cell.algorithm.upper(),
                cell.sharing,
                str(cell.seeds),
                tables.number(cell.value, cell.interval),
                tables.number(cell.paper_mean, cell.paper_interval),
                f"{cell.difference:+.1f}",
                cell.apart,
            ]
            for cell in cells.rename(columns={"mean": "value"}).itertuples()
        ]
        return tables.to_markdown(header, body) or "None."

    def interquartile_means(self, sharing: str) -> str:
        """By algorithm and family, with intervals where all tasks have several seeds; tasks and runs in brackets."""
        families = [name for name in FAMILIES if (self.normalised["family"] == name).any()]
        scores = {name: measures.final_scores(self.normalised[self.normalised["family"] == name]) for name in families}

        def cell(algorithm: str, family: str) -> str:
            tasks = list(scores[family].get((algorithm, sharing), {}).values())
            numbers = f" ({len(tasks)}, {sum(map(len, tasks))})"
            return score_text(measures.interquartile_mean, tasks) + numbers if tasks else ""

        titles = {name: FAMILIES[name] for name in families}
        return tables.grid(in_capitals(self.normalised["algorithm"]), titles, cell)

    def improvements(self, sharing: str) -> str:
        """How probably the algorithm of a line beats that of a column, over the tasks that both were run on."""
        scores = measures.final_scores(self.normalised)

        def cell(name: str, other: str) -> str:
            ours, theirs = scores[name, sharing], scores[other, sharing]
            common = sorted(ours.keys() & theirs.keys())
            pair = [ours[task] for task in common], [theirs[task] for task in common]
            return score_text(measures.probability_of_improvement, *pair) if common and other != name else ""

        present = in_capitals(name for name, with_sharing in scores if with_sharing == sharing)
        return tables.grid(present, present, cell)

    def cpu_table(self) -> str:
        """Mean CPU hours of a run by algorithm and family."""
        index = self.hours.index

        def cell(row: tuple[str, str], family: str) -> str:
            key = (family, *row)
            return "{mean:.3f} ({runs:.0f})".format(**self.hours.loc[key]) if key in index else ""

        algorithms = in_capitals(index.get_level_values("algorithm"))
        rows = {
            (name, sharing): f"{title}, {words}"
            for name, title in algorithms.items()
            for sharing, words in plots.SHARING.items()
        }
        there = {name: title for name, title in FAMILIES.items() if name in index.get_level_values("family")}
        return tables.grid(rows, there, cell)

    def cpu_sentence(self) -> str:
        """What all runs took together, beside the paper's."""
        total, number = self.hours["total"].sum(), int(self.hours["runs"].sum())
        return (
            f"These {number} runs, those with default flags, took {total:,.1f} CPU hours, {total / number:.2f} a run. "
            f"The paper's {PAPER_RUNS:,} took {PAPER_CPU_HOURS:,}, {PAPER_CPU_HOURS / PAPER_RUNS:.0f} a run; those in "
            "SMAC had five cores each."
        )

    def speed_table(self) -> str:
        """Steps per second of each task, the paper's, the original package's and ours."""
        wide = self.speeds.pivot_table(index="task", columns="whose", values="steps_per_second")
        columns = list(dict.fromkeys(self.speeds["whose"]))
        body = []
        for task in tables.in_order(wide.index):
            values = [wide.loc[task, column] for column in columns]
            body.append([task, *("-" if np.isnan(value) else f"{value:,.0f}" for value in values)])
        return tables.to_markdown(["task", *columns], body)

    def verdicts(self) -> list[tuple[claims.Claim, claims.Verdict, claims.Verdict]]:
        """The paper's claims, judged by its own tables and by our results."""
        hours = measures.hours_of_cells(self.shown)
        return [*zip(claims.CLAIMS, claims.judge(self.paper), claims.judge(self.ours, hours))]

    def claims_table(self) -> tuple[str, str]:
        """The claims with their verdicts; and sentences with the number of each verdict and what ties change. Nothing
        where our results have no figure for any."""
        verdicts = self.verdicts()
        if not any(ours.figures for _, _, ours in verdicts):
            return "", ""
        header = ["section", "claim", "by the paper's tables", "by our results", "holds in", "without stand-ins"]
        body = [
            [
                claim.place,
                claim.sentence,
                paper.verdict,
                ours.verdict,
                ours.shares,
                ours.alone,
                ours.figures,
                ours.rests_on,
            ]
            for claim, paper, ours in verdicts
        ]
        number = Counter(ours.verdict for _, _, ours in verdicts)
        counts = (
            f"Of the {len(verdicts)} claims {number[claims.HOLDS]} hold by our results, {number[claims.FAILS]} do not, "
            f"{number[claims.CLOSE]} are too close to call, and {number[claims.UNKNOWN]} are not measured. "
            f"{self.what_ties_change(verdicts)}"
        )
        return tables.to_markdown([*header, "our figures", "rests on"], body), counts

    def what_ties_change(self, verdicts: list[tuple[claims.Claim, claims.Verdict, claims.Verdict]]) -> str:
        """The verdicts that would be others if returns that lie within 0.1 % of the best were no ties."""
        found = [
            f'by {whose} "{claim.sentence}" would read "{verdict.strict}" and not "{verdict.verdict}"'
            for claim, paper, ours in verdicts
            for whose, verdict in (("the paper's tables", paper), ("our results", ours))
            if verdict.strict != verdict.verdict
        ]
        changed = "; ".join(found) or "no verdict would be another"
        return f"Returns that differ by 0.1 % of the most that a game can give, or less, are ties. Otherwise {changed}."

    def long(self) -> str:
        """What stands in RESULTS.md."""
        seeds = self.evaluations.groupby([*KEY, "seed"]).ngroups
        tasks = self.evaluations["task"].nunique()
        parts = ["# Results", "Made by `python benchmark/report.py`."]
        parts += [f"{seeds} run{'s' * (seeds != 1)} on {tasks} task{'s' * (tasks != 1)}. {self.agreement()}"]
        if len(self.compared):
            parts += [self.agreement_table(), "## What was run", self.coverage(), self.coverage_table()]
        older = self.both["task"].map(has_older_rules).astype(bool)
        parts += ["## Tables", tables.LEGEND, *titled_tables(self.both[~older])]
        if len(self.compared):
            parts += ["### Where we do not agree with the paper", self.differences()]
        if len(self.against_own):
            own = tables.compare(our_cells(self.evaluations, own_opponent=True), self.paper)
            parts += ["## Against our own opponents", OWN_OPPONENTS, *titled_tables(own, " against our own opponents")]
        if older.any():
            parts += ["## By older rules", OLDER_RULES, *titled_tables(self.both[older], " by older rules")]
        if table := tables.variants(self.evaluations, pd.concat([self.shown, self.against_own])):
            parts += ["### Other flags and budgets", table]
        if figures := self.figures():
            parts += ["## Figures", *(f"![{name}](figures/{name}.png)" for name in figures)]
        if len(self.normalised):
            parts += ["## Over all tasks", OVER_ALL]
        of_all = {"Interquartile means": self.interquartile_means, "Probability of improvement": self.improvements}
        for (title, make), (sharing, words) in itertools.product(of_all.items(), plots.SHARING.items()):
            if table := make(sharing):
                parts += [f"### {title}, {words}", table]
        if len(self.hours):
            parts += ["## CPU hours a run (number of runs)", self.cpu_table(), self.cpu_sentence()]
        if len(self.speeds):
            parts += ["## Simulation speed, environment steps per second on one core", self.speed_table()]
        table, counts = self.claims_table()
        if table:
            parts += ["## The paper's claims", CLAIMS_WORDS, counts, table]
        return paragraphs(parts)

    def short(self) -> str:
        """What stands in the repository's README.md."""
        parts = [
            "Average returns over training, with parameter sharing and the paper's budgets, on one task of each family:"
            " ours, and the paper's in brackets. A small number is the number of our seeds, where it is not five.",
            tables.short(self.both),
            self.agreement(),
            self.agreement_in_short(),
            "[All tables](benchmark/RESULTS.md) have intervals, maximum returns, learning curves, CPU hours and the "
            "paper's claims one by one.",
        ]
        if "normalised-shared" in self.figures():
            parts.append("![Normalised returns over training](benchmark/figures/normalised-shared.png)")
        return paragraphs([part for part in parts if part])


AGREEMENT_WORDS = """\
The test: for one seed of ours the interval has the spread of the paper's five, for several the spread of ours and
theirs together, and Student's t with 4, or 3 more than our seeds, degrees of freedom. False alarms: how many runs that
are as the paper's it would reject, by simulation. An interval printed as 0.00 counts as 0.005. Placebo: how many values
of another of our algorithms on the same task would agree with the paper's; where it is high, the test sees little. In
the matrix games the cells of IQL, VDN and QMIX have, by the same seeds of PyTorch, the very networks that the paper's
runs began with, and often its values to the last digit: they are no independent replication. Left out are {left_out}
cells in which nothing can differ: our seeds do not vary, or both values are the most that the game can return, and the
paper's interval is printed as 0.00."""


MAXIMA_WORDS = """\
The maximum of a single seed is the best of 41 points, and picks more of their noise than the maximum of a mean of five
seeds. The last column is without this surplus, as `benchmark/agreement.py` estimates it."""


OWN_OPPONENTS = """\
In Adversary and Tag the paper's teams played against trained networks of its own. The tables above are of runs against
those, and these of runs against the networks of this repository: another game, which nothing of the paper compares
with. They are in no count."""


OLDER_RULES = """\
These tasks stood in for SMAC's until their rules were found to be too far from the game's. The newer rules have names
of their own (`-sc2-v2`), so that no table has results of both, and nothing of the paper is compared with the older
ones."""


OVER_ALL = """\
Scores are the returns at the last evaluation, normalised on each task by the lowest and highest return that any run had
there at any time. Interquartile mean: the mean of the middle half of the runs. Probability of improvement: how probably
a run of the line's algorithm is above one of the column's on the same task, over the tasks that both have. In square
brackets 95 % intervals from 2,000 bootstrap samples, drawn task by task; in round ones tasks and runs. Algorithms that
were run on different tasks do not compare in the first table."""


CLAIMS_WORDS = f"""\
A selection of what the paper's sections 5 and 6 say, by maximum returns with sharing unless a sentence says otherwise;
in brackets how a sentence is read here. The head of `benchmark/claims.py` says what the words mean, and
`benchmark/paper/claims.csv` what must hold. By these meanings some of the sentences do not hold in the paper's own
tables. The cells with fewer than five seeds were completed to five, {claims.DRAWS:,} times, with the spread of the
paper's seeds and within the bounds of each game. "Holds in": in what share of these tables the claim holds, with twice
the standard error of this share, and in what share cells that do not exist decide. A claim holds, or does not, where
95 % of the tables say so, by more than this error. Else it is too close to call; or not measured, if cells that do not
exist could still decide it. "Without stand-ins": the same without the tasks `smaclite-...`, which stand in for
SMAC's and are not the same games. "Our figures": yes and no say what holds in most of the completed tables, and the
numbers in brackets are as measured. So a "no" may stand beside a number that says yes by little. The last column says
on which cells a verdict rests, and what one seed more of each would cost."""


def paragraphs(parts: list[str]) -> str:
    """Markdown of these parts; what is not a table, a picture or a heading in lines of 120 characters."""
    return "\n\n".join(part if part.startswith(("|", "!", "#")) else fill(part) for part in parts)


def fill(text: str) -> str:
    """A paragraph in lines of 120 characters."""
    return textwrap.fill(text, 120, break_on_hyphens=False)


def titled_tables(both: pd.DataFrame, of: str = "") -> list[str]:
    """The paper's tables that we have results for, a title before each. of: what the title adds."""
    parts = []
    for (metric, title), (sharing, words) in itertools.product(tables.TITLES.items(), plots.SHARING.items()):
        if table := tables.markdown(both, metric, sharing):
            parts += [f"### {title}{of}, {words}", table]
    return parts


def in_capitals(algorithms: Iterable[str]) -> dict[str, str]:
    """Algorithms in the tables' order, with their names as titles show them."""
    return {name: name.upper() for name in algorithm_order(algorithms)}


def score_text(measure: Callable[..., np.ndarray], *teams: list[np.ndarray]) -> str:
    """A measure of one or two teams' scores, with its interval where all tasks have several seeds."""
    value, low, high = measures.with_interval(measure, *teams)
    several = all(len(seeds) > 1 for team in teams for seeds in team)
    return f"{value:.2f} [{low:.2f}, {high:.2f}]" if several else f"{value:.2f}"


def digest(results: Path) -> str:
    """A hash of all results, which stands beside the figures that were drawn from them."""
    found = hashlib.sha256()
    for path in sorted(results.glob("**/*.csv")) + sorted(results.glob("*/*.json")):
        found.update(path.relative_to(results).as_posix().encode())
        found.update(path.read_text(encoding="utf-8").encode())  # as text: line ends depend on the checkout
    return found.hexdigest()


def marl_eval(evaluations: pd.DataFrame) -> dict:
    """The runs with the paper's settings as marl-eval reads them: by environment, task, algorithm, run and step.

    An evaluation is one number, the mean of its episodes. The absolute metric, which marl-eval takes from ten times as
    many episodes of the best policy, is the run's best evaluation here.
    """
    made: dict = {}
    chosen = evaluations[evaluations["setting"] == PAPER_SETTING]
    if chosen.empty:
        raise InputError("marl-eval's file is made of runs with default flags, and there are none.")
    for (family, task, algorithm, sharing, seed), run in chosen.groupby(
        ["family", "task", "algorithm", "sharing", "seed"], sort=False
    ):
        steps = {
            f"step_{row.point}": {
                "step_count": row.timestep,
                "elapsed_time": row.wall_seconds,
                "return": [row.return_mean],
            }
            for row in run.itertuples()
        }
        steps["absolute_metrics"] = {"return": [run["return_mean"].max()]}
        seeds = made.setdefault(family, {}).setdefault(task, {}).setdefault(f"{algorithm}_{sharing}", {})
        seeds[f"seed_{seed}"] = steps
    return made


def evaluations_csv(evaluations: pd.DataFrame) -> str:
    """Every evaluation of every run as CSV, for a reader's own analysis.

    setting: the flags that differ from the paper's, as JSON; return and return_std: mean and standard deviation over an
    evaluation's episodes; cpu_seconds: of the run up to there; commit: with which the run was made.
    """
    table = evaluations.rename(columns={"return_mean": "return"}).sort_values([*KEY, "seed", "point"])
    return table.to_csv(columns=EVALUATION_COLUMNS, index=False, float_format="%.6g", lineterminator="\n")


def between_markers(path: Path, text: str) -> str:
    """The file's text with `text` between the markers. Raises InputError where the file lacks them."""
    whole = path.read_text(encoding="utf-8")
    before, begin, rest = whole.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError(f"{path} does not have the two lines between which the results stand: {BEGIN} and {END}")
    return f"{before}{BEGIN}\n\n{text}\n\n{END}{after}"


@one_sentence(__file__)
def main() -> None:
    """Writes the report. Wrong input ends with one sentence and exit code 2."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=RESULTS, help="the tables; default: benchmark/results")
    parser.add_argument("--output", type=Path, default=HERE, help="a folder for the report; default: benchmark")
    parser.add_argument("--marl-eval", type=Path, help="also write the evaluations to this file, in marl-eval's JSON")
    parser.add_argument("--grid", type=Path, metavar="folder", help="only print what a search in this folder found")
    args = parser.parse_args()
    if args.grid:
        print(tables.variants(load(args.grid)))
        return
    report = Report(args.results)
    if args.marl_eval:  # first: where this cannot be written, the others stay as they are
        runs.write_whole(args.marl_eval, json.dumps(marl_eval(report.evaluations)))
    (args.output / "figures").mkdir(parents=True, exist_ok=True)
    texts = {args.output / "RESULTS.md": report.long() + "\n", args.output / "tables.csv": tables.to_csv(report.both)}
    if args.output.resolve() == HERE:
        texts[HERE.parent / "README.md"] = between_markers(HERE.parent / "README.md", report.short())
    for name, draw in report.figures().items():
        plots.save(draw(), args.output / "figures" / name)
    runs.write_whole(args.output / "figures" / "source.txt", report.digest + "\n")
    for path, text in texts.items():
        runs.write_whole(path, text)
    (args.output / "evaluations.csv.gz").write_bytes(
        gzip.compress(evaluations_csv(report.evaluations).encode(), mtime=0)
    )
    print(f"The report is in {args.output}. Texts: {len(texts)}. Figures: {len(report.figures())}.")


if __name__ == "__main__":
    main()
