"""Our results beside the paper's, as a Markdown table.

    python benchmark/report.py [task ...]

Maximum: the mean over seeds at each evaluation point, then the best point; "at step 0" where that lies before the
training, as the luck of random networks. Average: the mean over points and seeds. Last: the last point. Behind +-:
2 s / sqrt(n), s the sample standard deviation over n seeds (for the average, of the seeds' own means); the paper's 95 %
intervals are this with n = 5. Fewer seeds are marked with a star; a single one has no interval. A number of steps
behind the algorithm is a budget other than the paper's: its average does not compare.
"""

import argparse
import csv
import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
PAPER_SEEDS = 5


def mean_and_interval(values: np.ndarray) -> str:
    """values: one for each seed."""
    if len(values) == 1:
        return f"{values[0]:.2f}"
    return f"{values.mean():.2f} +- {2 * values.std(ddof=1) / np.sqrt(len(values)):.2f}"


def paper_cell(paper: dict[tuple[str, ...], tuple[str, str]], *key: str) -> str:
    """A cell of the paper's tables, a dash where it has none."""
    return "{} +- {}".format(*paper[key]) if key in paper else "-"


def main() -> None:
    """Prints the table."""
    paths = sorted((HERE / "results").glob("*/*.csv"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", metavar="task", help="only these; default: all that have results")
    chosen = parser.parse_args().tasks
    if unknown := sorted(set(chosen) - {path.parent.name for path in paths}):
        parser.error(f"there are no results of {', '.join(unknown)}")
    with open(HERE / "paper" / "returns.csv") as file:
        rows = list(csv.DictReader(file))
    keys = ("metric", "parameter_sharing", "task", "algorithm")
    paper = {tuple(row[key] for key in keys): (row["mean"], row["ci95"]) for row in rows}
    print("| task | algorithm | seeds | maximum | paper | average | paper | last |")
    print("|---|---|---|---|---|---|---|---|")
    for path in paths:
        task, (algorithm, sharing, *rest) = path.parent.name, path.stem.split("-", 2)
        changed = re.findall("[a-z][a-z-]*=.*?(?=-[a-z][a-z-]*=|$)", "".join(rest))  # <flag>=<value> each
        if chosen and task not in chosen:
            continue
        curves = defaultdict(list)
        with open(path) as file:
            for row in csv.DictReader(file):
                curves[row["seed"]].append(float(row["return_mean"]))
        returns = np.array(list(curves.values()))  # [seed, point]
        best = returns.mean(0).argmax()
        shared = "yes" if sharing == "shared" else "no"
        name = algorithm if shared == "yes" else f"{algorithm}, no sharing"
        budget = json.loads(path.with_suffix(".json").read_text())["flags"]["total_timesteps"]
        cells = [
            task,
            name + "".join(f", {budget:,} steps" if "total-timesteps" in flag else f", {flag}" for flag in changed),
            f"{len(returns)}{'' if len(returns) >= PAPER_SEEDS else '*'}",
            mean_and_interval(returns[:, best]) + (" at step 0" if best == 0 else ""),
            paper_cell(paper, "max_return", shared, task, algorithm),
            mean_and_interval(returns.mean(1)),
            "-" if changed else paper_cell(paper, "average_return", shared, task, algorithm),
            mean_and_interval(returns[:, -1]),
        ]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
