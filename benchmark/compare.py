"""Compares your algorithm with another one, and says what may be claimed.

    python benchmark/compare.py mine mappo --results my-results [more results ...] --output my-comparison

reads the results of one or more folders and writes comparison.md and curves.png (and .svg) into the output folder. With
`--results my-results benchmark/results` the second algorithm need not be run: the committed results have it.

Compared are the runs that have the same task, sharing, changed flags and budget; of a run that two folders have, the
first counts. The measure is the average return: the mean over all evaluations of a run. The test is Student's t of two
samples with equal variances, over seeds. Runs of both sides with the same seed are no pairs: outside the matrix games
their returns hardly rise and fall together, and pairs have half as many degrees of freedom. With several comparisons at
once each has its share of the 5 %, so that with no true difference one such page in twenty claims one.
docs/how-to/compare-mine.md is an example from beginning to end.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import NamedTuple

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from scipy.optimize import brentq
from scipy.stats import nct, t

import envs
from benchmark import plots
from benchmark.agreement import LEVEL
from benchmark.store import RESULTS, load
from envs import runs
from envs.runs import Parser, one_sentence

POWER = 0.8
GROUP = ["task", "sharing", "setting", "total_timesteps"]  # what both sides must have in common


class Difference(NamedTuple):
    """Of two algorithms' average returns, the first minus the second."""

    value: float
    half_width: float  # of its interval; infinite where no side has two seeds
    detectable: float  # the true difference that this test finds in `POWER` of all such experiments


def difference(mine: pd.Series, other: pd.Series, level: float) -> Difference:
    """By Student's t-test; one value of each sample for each seed. A side may have a single seed: the spread is the
    other's then."""
    value, freedom = float(mine.mean() - other.mean()), len(mine) + len(other) - 2
    if freedom == 0:
        return Difference(value, np.inf, np.inf)
    squares = ((mine - mine.mean()) ** 2).sum() + ((other - other.mean()) ** 2).sum()
    error = np.sqrt(squares / freedom * (1 / len(mine) + 1 / len(other)))
    quantile = t.ppf(1 - level / 2, freedom)
    # Where the true difference is x standard errors, the test's value has the noncentral t distribution of x
    needed = brentq(lambda x: nct.sf(quantile, freedom, x) - POWER, 0, 10 * quantile)
    return Difference(value, float(quantile * error), float(needed * error))


def identical(mine: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether both sides have some seeds in common, and in all of these the same returns at all points."""
    both = mine.merge(other, on=["seed", "point"])
    return len(both) > 0 and bool((both["return_mean_x"] == both["return_mean_y"]).all())


def claim(names: list[str], task: str, found: Difference, level: float) -> str:
    """What may be said of one comparison; level: of its test."""
    mine, other = names
    if np.isinf(found.half_width):
        return f"Nothing may be claimed on {task}: one seed each does not show how much seeds differ."
    interval = f"{100 * (1 - level):.4g} % interval"
    low, high = found.value - found.half_width, found.value + found.half_width
    if low > 0 or high < 0:
        word = "higher" if low > 0 else "lower"
        return (
            f"You may claim: on {task}, with these flags and this budget, {mine} has a {word} average return than "
            f"{other}, by {abs(found.value):.3f} (between {min(abs(low), abs(high)):.3f} and "
            f"{max(abs(low), abs(high)):.3f}, the {interval}). Of other tasks and budgets this says nothing."
        )
    return (
        f"No difference may be claimed on {task}: it lies between {low:+.3f} and {high:+.3f} (the {interval}). That "
        "the two are equal is not shown either: with this spread and these seeds, a true difference of "
        f"{found.detectable:.3f} is found in {100 * POWER:.0f} % of such experiments, and a smaller one less often."
    )


class Comparison:
    """The evaluations of two algorithms where they have settings in common. InputError where they have none."""

    def __init__(self, names: list[str], folders: list[Path]):
        self.names = names
        evaluations = pd.concat([load(folder) for folder in folders], ignore_index=True)
        evaluations = evaluations.drop_duplicates([*GROUP, "algorithm", "seed", "point"])
        there = set(evaluations["algorithm"])
        if missing := [name for name in names if name not in there]:
            raise envs.InputError(
                f"there are no results of {', '.join(missing)}; there are some of {', '.join(sorted(there))}."
            )
        chosen = evaluations[evaluations["algorithm"].isin(names)]
        both = chosen.groupby(GROUP)["algorithm"].transform("nunique") == 2
        if not both.any():
            raise envs.InputError(f"{' and '.join(names)} have no task, sharing, changed flags and budget in common.")
        self.evaluations = chosen[both]
        self.groups = [*self.evaluations.groupby(GROUP, sort=False)]
        self.level = LEVEL / len(self.groups)

    def averages(self, rows: pd.DataFrame) -> list[pd.Series]:
        """Each algorithm's average returns, by seed."""
        return [rows[rows["algorithm"] == name].groupby("seed")["return_mean"].mean() for name in self.names]

    def title(self, key: tuple) -> str:
        """What a comparison is of."""
        task, sharing, setting, _ = key
        flags = ", ".join(f"{name} {value}" for name, value in json.loads(setting).items())
        return f"{task}, {plots.SHARING[sharing]}" + (f", {flags}" if flags else "")

    def page(self) -> str:
        """The comparison as Markdown."""
        mine, other = self.names
        lines = ["| task | algorithm | seeds | average return | at the last point |", "|---|---|---|---|---|"]
        claims = []
        for key, rows in self.groups:
            samples = mine_averages, other_averages = self.averages(rows)
            for name, sample in zip(self.names, samples):
                last = rows[(rows["algorithm"] == name) & (rows["point"] == rows["point"].max())]["return_mean"]
                cells = (self.title(key), name, len(sample), mean_in_words(sample), mean_in_words(last))
                lines.append("| " + " | ".join(map(str, cells)) + " |")
            sides = [rows[rows["algorithm"] == name] for name in self.names]
            if identical(*sides):
                said = (
                    f"Nothing is compared on {self.title(key)}: {mine} and {other} have the same returns at every "
                    "evaluation of every seed that both have. What you changed has no effect there."
                )
            else:
                found = difference(mine_averages, other_averages, self.level)
                said = claim(self.names, self.title(key), found, self.level)
            claims.append(f"* {said}")
        commits = self.evaluations.groupby("algorithm", sort=False)["commit"].unique()
        made = [f"{name}: {', '.join(str(commit)[:10] for commit in commits[name])}" for name in self.names]
        number = len(self.groups)
        tests = f"{number} comparisons, each at the level {self.level:.2g}" if number > 1 else "one comparison"
        parts = [
            f"# {mine} and {other}",
            "\n".join(claims),
            "![Returns over training](curves.png)",
            "\n".join(lines),
            "Average return: the mean over all evaluations of a run. Intervals are Student's, 95 %, over seeds; in the "
            "figure as bands, with a thin line for each seed. The difference is tested by Student's t-test of two "
            f"samples with equal variances ({tests}). Decide on the measure before the runs: who takes the one "
            "that comes out best afterwards has made more comparisons than this page counts.",
            f"Commits of the runs: {'; '.join(made)}.",
        ]
        return "\n\n".join(parts) + "\n"

    def curves(self) -> Figure:
        """Returns over training, one panel for each comparison."""
        figure, panels = plots.panels(len(self.groups), 3, "timesteps", "return")
        for (key, rows), panel in zip(self.groups, panels):
            for name in self.names:
                seeds = rows[rows["algorithm"] == name].pivot(index="point", columns="seed", values="return_mean")
                steps = rows[rows["algorithm"] == name].groupby("point")["timestep"].mean()
                number = seeds.shape[1]
                quantile = t.ppf(1 - LEVEL / 2, number - 1) if number > 1 else 0.0
                plots.curve(panel, name, steps, seeds.mean(axis=1), quantile * seeds.std(axis=1) / np.sqrt(number))
                for seed in seeds:
                    panel.plot(steps, seeds[seed], **plots.style(name), lw=0.4)
            panel.xaxis.set_major_formatter(EngFormatter())
            panel.set_title(key[0], fontsize=min(10.8, 330 / len(key[0])))
        plots.legend(figure, self.names)
        return figure


def mean_in_words(sample: pd.Series) -> str:
    """A mean over seeds with the half width of its interval, where there are two seeds or more."""
    if len(sample) == 1:
        return f"{sample.mean():.3f}"
    width = t.ppf(1 - LEVEL / 2, len(sample) - 1) * sample.std() / np.sqrt(len(sample))
    return f"{sample.mean():.3f} ± {width:.3f}"


@one_sentence(__file__)
def main() -> None:
    """Writes the comparison. Wrong input ends with one sentence and exit code 2."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs=2, metavar="algorithm", help="yours, and the one to compare it with")
    parser.add_argument("--results", type=Path, nargs="+", default=[RESULTS], metavar="folder", help="where both are")
    parser.add_argument("--output", type=Path, required=True, metavar="folder", help="for comparison.md and curves.png")
    args = parser.parse_args()
    if len(set(args.names)) < 2:
        parser.error(f"{args.names[0]} is compared with another algorithm, not with itself")
    comparison = Comparison(args.names, args.results)
    page = comparison.page()
    args.output.mkdir(parents=True, exist_ok=True)
    plots.save(comparison.curves(), args.output / "curves")
    runs.write_whole(args.output / "comparison.md", page)
    print(page)


if __name__ == "__main__":
    main()
