"""What a search found: the variants of an algorithm's flags by their scores, the winner beside the paper's choice.

    python benchmark/run.py --algorithms ia2c --tasks lbf-15x15-3p-5f --grid benchmark/grids/paper.csv
    python benchmark/report.py --grid benchmark/searches/paper

The paper's protocol: every combination of the flags in `grids/paper.csv` is run with three seeds. Its score is the
best evaluation point of the mean over the seeds. The winner serves all tasks of the family. The paper searched on one
task of each family (MPE Speaker-Listener, SMAC 3s5z, LBF 15x15-3p-5f, RWARE tiny-4p; it does not say which matrix
game), with and without parameter sharing. Of MADDPG's actor regularisation only the chosen values are known.

Variants may have the same score, as where all of them solve a task. The paper does not say how it chose then; here the
highest average return decides.
"""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.measures import summarise
from benchmark.store import KEY, load, read_settings, setting_name

SEEDS = 3
NOT_SEARCHED = {"total_timesteps", "eval_points", "eval_episodes"}
GROUP = ["task", "algorithm", "sharing", "total_timesteps"]  # settings that compare with each other
Flags = dict[str, Any]


def ranked(evaluations: pd.DataFrame) -> pd.DataFrame:
    """The settings of every GROUP, the best first; columns as `results.summarise` has them."""
    summary = summarise(evaluations).reset_index()
    summary = summary.merge(evaluations[[*KEY, "total_timesteps"]].drop_duplicates(), on=KEY)
    summary["score"] = summary["maximum"].round(9)  # equal scores may differ in their last bits
    return summary.sort_values([*GROUP, "score", "average"], ascending=[True, True, False, False, False, False])


def read_flags(results: Path) -> dict[tuple[Any, ...], Flags]:
    """All flags of every table, by task, algorithm, sharing and setting."""
    found = {}
    for file in results.glob("*/*.json"):
        settings = read_settings(file.with_suffix(""))
        flags = settings["flags"]
        key = (flags["env"], settings["algorithm"], flags["parameter_sharing"], setting_name(settings["changed"]))
        found[key] = flags
    return found


def search_report(results: Path) -> str:
    """The searches that were collected into a folder, as Markdown. ValueError where there are none."""
    evaluations = load(results)
    flags = read_flags(results)
    budgets = evaluations.groupby(["task", "algorithm"])["paper_timesteps"].first()
    parts = []
    for (task, algorithm, sharing, _), rows in ranked(evaluations).groupby(GROUP, sort=False):
        variants = [flags[task, algorithm, sharing, setting] for setting in rows["setting"]]
        title = f"### {algorithm} {'with' if sharing else 'without'} parameter sharing on {task}"
        parts += [title, in_sentences(rows, variants, budgets[task, algorithm]), variants_table(rows, variants)]
    return "\n\n".join(parts)


def is_the_papers(setting: str) -> bool:
    """Whether a setting is the paper's choice, the length of training aside."""
    return set(json.loads(setting)) <= NOT_SEARCHED


def searched_flags(variants: list[Flags]) -> list[str]:
    """The flags that are not the same in all variants that have them: later versions of a script have more."""
    names = dict.fromkeys(name for variant in variants for name in variant)
    return [name for name in names if len({str(variant[name]) for variant in variants if name in variant}) > 1]


def in_sentences(rows: pd.DataFrame, variants: list[Flags], paper_timesteps: int) -> str:
    """How much was run, the winner, and where the paper's choice stands."""
    runs, steps = rows["seeds"].sum(), variants[0]["total_timesteps"]
    budget = f"{steps:,} timesteps" + ("" if steps == paper_timesteps else f" (the paper: {paper_timesteps:,})")
    names = searched_flags(variants)
    winner = ", ".join(f"{name} {variants[0].get(name, '-')}" for name in names) or "the only variant"
    many = "1 variant" if len(rows) == 1 else f"{len(rows)} variants"
    text = [f"{many}, {runs} {'run' if runs == 1 else 'runs'} of {budget}. The winner: {winner}."]
    equals = (rows["score"] == rows["score"].iloc[0]).sum()
    if equals > 1:
        text.append(f"{equals} variants have its score; among them the average return decides.")
    places = [place for place, setting in enumerate(rows["setting"], start=1) if is_the_papers(setting)]
    if places == [1]:
        text.append("It is the paper's choice.")
    elif places:
        text.append(f"The paper's choice has place {places[0]}.")
    else:
        text.append("The paper's choice is not among them.")
    if (rows["seeds"] < SEEDS).any():
        text.append(f"The search is not complete: some variants have fewer than {SEEDS} seeds.")
    return " ".join(text)


def variants_table(rows: pd.DataFrame, variants: list[Flags]) -> str:
    """The variants, the best first."""
    names = searched_flags(variants)
    lines = [["", *names, "seeds", "score", "average return"], ["---"] * (len(names) + 4)]
    for place, (row, variant) in enumerate(zip(rows.itertuples(), variants), start=1):
        choice = " (the paper's)" if is_the_papers(row.setting) else ""
        flags = [str(variant.get(name, "-")) for name in names]
        lines.append([f"{place}{choice}", *flags, str(row.seeds), f"{row.score:.2f}", f"{row.average:.2f}"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
