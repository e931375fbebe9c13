"""The figures of the pages "The paper, run again", from the paper's tables, benchmark/results and what is tested.

    python tools/paper_run_again.py opponents
    python tools/paper_run_again.py probes [<the paper's adversary>.npz <the paper's prey>.npz]
    python tools/paper_run_again.py words [<run directory of mpe-speaker-listener> ...]
    python tools/paper_run_again.py flight [<run directory of IPPO on smaclite-2s_vs_1sc-sc2>]
    python tools/paper_run_again.py corridor [<run directory of IA2C on smaclite-corridor-sc2-v2>]
    python tools/paper_run_again.py fall [<an update of MAPPO that was saved as the page says>]
    python tools/paper_run_again.py page

The last one writes the figures of all parts into docs/paper-run-again.md and the pages of docs/paper-run-again/, as
after new results; read their sentences then, too. `PARTS` at the end lists the parts. Probes of the paper's networks
need its files, which are not in this repository; examples/paper_opponents.py converts them.

A test holds the pages' figures against what this prints.
"""

import contextlib
import dataclasses
import functools
import io
import itertools
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest, fisher_exact, ttest_ind_from_stats
from scipy.stats import f as f_distribution

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "algos"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import agreement, claims, store, tables
from benchmark.measures import interval, our_cells, paper_setting
from benchmark.plan import ALGOS, script
from benchmark.report import Report
from benchmark.store import INDEPENDENT, PAPER_SEEDS, RESULTS, SHARED, paper_cells, setting_name

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "docs" / "paper-run-again.md", *sorted((ROOT / "docs" / "paper-run-again").glob("*.md"))]
ABLATIONS = ROOT / "benchmark" / "ablations"
ON_POLICY = ["ia2c", "ippo", "coma", "maa2c", "mappo"]
OFF_POLICY = ["iql", "vdn", "qmix", "maddpg"]
MATRIX = ["matrix-climbing", *(f"matrix-penalty-{k}" for k in (0, 25, 50, 75, 100))]
SHARING = {SHARED: "with sharing", INDEPENDENT: "without"}
TRAINED_AGAINST = ("mpe-adversary", "mpe-tag")


@functools.cache
def report() -> Report:
    """Everything that report.py writes is made of this."""
    return Report(RESULTS)


def table(evaluations: pd.DataFrame, task: str, algorithm: str, sharing: str = SHARED) -> pd.DataFrame:
    """The evaluations of one table."""
    chosen = evaluations[(evaluations["task"] == task) & (evaluations["algorithm"] == algorithm)]
    return chosen[chosen["sharing"] == sharing]


def curves(evaluations: pd.DataFrame, task: str, algorithm: str, sharing: str = SHARED) -> pd.DataFrame:
    """The returns of one table: [point, seed]."""
    return table(evaluations, task, algorithm, sharing).pivot(index="point", columns="seed", values="return_mean")


def ours(task: str, algorithm: str, sharing: str = SHARED) -> pd.DataFrame:
    """The returns of one of our tables: [point, seed]."""
    return curves(report().shown, task, algorithm, sharing)


@functools.cache
def paper(metric: str) -> dict[tuple[str, str, str], tuple[float, float]]:
    """(task, algorithm, sharing) -> (mean, interval) of one of the paper's tables."""
    cells = paper_cells()
    cells = cells[cells["metric"] == metric]
    keys = cells[["task", "algorithm", "sharing"]].itertuples(index=False, name=None)
    return dict(zip(keys, cells[["mean", "interval"]].itertuples(index=False, name=None)))


def departures() -> None:
    """The hyperparameters that are not those that the paper prints."""
    table = pd.read_csv(store.PAPER / "hyperparameters.csv", dtype=str).dropna(subset=["printed"])
    for row in table[table["name"] == "learning_rate"].itertuples():
        sharing = SHARING[SHARED if row.parameter_sharing == "yes" else INDEPENDENT]
        print(f"{row.algorithm}, {row.family}, {sharing}: learning rate {row.value}, printed {row.printed}")


def new_seeds() -> None:
    """The test that was planned before the new seeds were run: on which side of the paper's values those of seeds 1 to
    4 lie, without seed 0, in the rows where those of seed 0 lay on one side. It waits until all its cells are there."""
    for title, tasks, metric in (
        ("Tag, against the paper's prey, averages", ("mpe-tag",), "average_return"),
        ("RWARE, maxima", claims.SETS["rware"], "max_return"),
    ):
        cells = {key: ours(*key) for key in itertools.product(tasks, ON_POLICY + OFF_POLICY)}
        there = [curve for curve in cells.values() if {1, 2, 3, 4} <= {*curve.columns}]
        if len(there) < len(cells):
            print(f"{title}: seeds 1 to 4 are there in {len(there)} of {len(cells)} cells; the test waits for all")
            continue
        for chosen in ([0], [1], [2], [3], [4], [1, 2, 3, 4]):
            above = agrees = 0
            for (task, algorithm), curve in cells.items():
                mean, error = paper(metric)[task, algorithm, SHARED]
                own, deviation = value(curve[chosen], metric)
                above += own > mean
                agrees += abs(own - mean) <= agreement.half_width(interval(deviation, len(chosen)), len(chosen), error)
            number = f"{above} of {len(cells)} above the paper's, {agrees} agree"
            if len(chosen) == 1:
                print(f"{title}, seed {chosen[0]}: {number}")
                continue
            p = binomtest(above, len(cells)).pvalue
            print(f"{title}, seeds 1 to 4 alone: {number}; sign test, as if cells were independent: p = {p:.2f}")


def value(curve: pd.DataFrame, metric: str) -> tuple[float, float]:
    """The average or the maximum of curves [point, seed], and its standard deviation over seeds."""
    if metric == "average_return":
        return curve.mean().mean(), curve.mean().std()
    best = curve.mean(axis="columns").idxmax()
    return curve.loc[best].mean(), curve.loc[best].std()


def updates() -> None:
    """How near the scripts' updates are to those recorded with EPyMARL: the bounds of the tests."""
    from check_exercise import TOLERANCES

    for name, (weights, losses) in TOLERANCES.items():
        with np.load(ROOT / "tests/data/updates" / f"{name}.npz") as file:
            commit = json.loads(str(file["fc_shared.hyperparameters"]))["epymarl_commit"]
        print(f"{name}: weights {weights:.0e}, losses and norms of gradients {losses:.0e}, EPyMARL {commit[:7]}")


def causes() -> None:
    """The averages and maxima that do not agree, by what is known of them."""
    number: Counter[str] = Counter()
    counted = report().counted
    for cell in counted[~counted["agrees"]].itertuples():
        if cell.family == "matrix" and cell.algorithm in ON_POLICY and cell.metric == "average_return":
            number["matrix games, on-policy averages"] += 1
        elif cell.family == "matrix":
            number["matrix games, MADDPG's maxima" if cell.algorithm == "maddpg" else "matrix games, others"] += 1
        else:
            sharing = "" if cell.sharing == SHARED else ", without sharing"
            number[cell.apart or f"{cell.algorithm.upper()} on {cell.task}{sharing}"] += 1
    print(f"{(~counted['agrees']).sum()} of {len(counted)} averages and maxima do not agree:")
    for cause, cells in number.most_common():
        print(f"{cells}  {cause}")


def identical() -> None:
    """Off-policy cells of the matrix games whose mean and interval are the paper's as they are printed."""
    for metric, name in agreement.METRICS.items():
        both = report().compared
        both = both[(both["metric"] == metric) & both["task"].isin(MATRIX) & both["algorithm"].isin(OFF_POLICY)]
        same = (both["mean"].round(2) == both["paper_mean"]) & (both["interval"].round(2) == both["paper_interval"])
        varies = ~agreement.is_trivial(both)
        for algorithm in OFF_POLICY:
            own = both["algorithm"] == algorithm
            print(f"{algorithm}, {name}: {(same & own & varies).sum()} of {(own & varies).sum()} that vary over seeds")


def length() -> None:
    """Average returns of the matrix games beside the paper's, if only the first points count."""
    theirs = paper("average_return")
    for name, algorithms in (("on-policy", ON_POLICY), ("off-policy", OFF_POLICY)):
        for points in (101, 90, 87, 86, 84, 83, 82):
            differences = []
            for key in itertools.product(MATRIX, algorithms, SHARING):
                mean, error = theirs[key]
                own = ours(*key).iloc[:points].mean()
                width = agreement.half_width(interval(own.std(), len(own)), len(own), error)
                differences.append((own.mean() - mean) / width)
            print(
                f"{name}, the first {points} points: {np.sum(np.abs(differences) <= 1)} of {len(differences)} averages "
                f"agree, root mean square {np.sqrt(np.mean(np.square(differences))):.1f}"
            )
    for task in MATRIX:
        cells = itertools.product(ON_POLICY, SHARING)
        starts = {tuple(ours(task, algorithm, sharing).iloc[0]) for algorithm, sharing in cells}
        print(f"{task}: the ten on-policy cells begin with {len(starts)} different sets of five returns")


def climbing() -> None:
    """Which returns of five seeds give the 175 ± 54.77 of the paper's VDN and QMIX, if both agents act alike."""
    for name, payoffs in (("as we have the rows", (11, 7, 5)), ("as they are printed", (0, 7, 0))):
        found = []
        for chosen in itertools.combinations_with_replacement(sorted({25 * x for x in payoffs}), 5):
            if abs(np.mean(chosen) - 175) < 0.01 and abs(interval(np.std(chosen, ddof=1), 5) - 54.77) < 0.01:
                found.append(chosen)
        print(f"{name}: {', '.join(map(str, found)) or 'none'}")
    for algorithm in ("ia2c", "ippo", "maa2c", "mappo"):
        last = sorted({round(x) for sharing in SHARING for x in ours("matrix-climbing", algorithm, sharing).iloc[-1]})
        maxima = [
            "{:.2f} ± {:.2f}".format(*paper("max_return")["matrix-climbing", algorithm, sharing]) for sharing in SHARING
        ]
        print(
            f"{algorithm}: the paper's maxima {' and '.join(maxima)}; our ten runs end at {', '.join(map(str, last))}"
        )


def untrained() -> None:
    """What the networks of the matrix games return before training, where the paper's maximum lies there."""
    for algorithm in ("iql", "vdn", "qmix"):
        for task, sharing in (("matrix-climbing", SHARED), ("matrix-penalty-100", INDEPENDENT)):
            table = ours(task, algorithm, sharing)
            first = ", ".join(f"{x:.0f}" for x in sorted(table.iloc[0]))
            last = ", ".join(f"{x:.0f}" for x in sorted(table.iloc[-1]))
            mean, error = paper("max_return")[task, algorithm, sharing]
            print(f"{algorithm}, {task}, {SHARING[sharing]}: before training {first}; at the end {last}; ", end="")
            print(f"the paper's maximum {mean:.2f} ± {error:.2f}")


def impossible() -> None:
    """Cells of the paper in which the average over training is above the maximum."""
    averages, maxima = paper("average_return"), paper("max_return")
    names: dict[tuple[str, str], list[str]] = {}
    for task, algorithm, sharing in maxima:
        average, maximum = averages[task, algorithm, sharing][0], maxima[task, algorithm, sharing][0]
        if average > maximum:
            names.setdefault((sharing, task), []).append(f"{algorithm} {average:.2f} over {maximum:.2f}")
    for (sharing, task), cells in names.items():
        print(f"{task}, {SHARING[sharing]}: {', '.join(cells)}")
    print(f"{sum(map(len, names.values()))} cells")


def exchanged() -> None:
    """MAA2C on Tag in the paper, with and without sharing, and the test against the best of either table."""
    averages, maxima = paper("average_return"), paper("max_return")
    both = {sharing: maxima["mpe-tag", "maa2c", sharing] for sharing in SHARING}
    for sharing, words in SHARING.items():
        (maximum, error), (average, its_error) = (table["mpe-tag", "maa2c", sharing] for table in (maxima, averages))
        print(f"{words}: maximum {maximum:.2f} ± {error:.2f}, average {average:.2f} ± {its_error:.2f}")
    for sharing, words in SHARING.items():
        best = max(
            mean_and_error for (task, _, its), mean_and_error in maxima.items() if (task, its) == ("mpe-tag", sharing)
        )
        for name, own in (
            ("printed", both[sharing]),
            ("exchanged", both[INDEPENDENT if sharing == SHARED else SHARED]),
        ):
            spreads = [error * np.sqrt(5) / 2 for _, error in (own, best)]
            p = ttest_ind_from_stats(own[0], spreads[0], 5, best[0], spreads[1], 5).pvalue
            print(f"{words}, as {name}: against the best p = {p:.3f}")
    odd = [
        f"{algorithm} {mean:.2f}"
        for (task, algorithm, _), (mean, _) in maxima.items()
        if task == "mpe-tag" and round(mean * 100) % 2
    ]
    print(f"maxima on Tag that are no multiple of 10 / 500: {', '.join(odd)}")


def beside_the_paper(evaluations: pd.DataFrame, task: str, algorithm: str, sharing: str = SHARED) -> str:
    """Our maximum and the seeds' own averages, in the paper's form."""
    curve = curves(evaluations, task, algorithm, sharing)
    own = ", ".join(f"{x:.2f}" for x in curve.mean())
    return f"maximum {curve.mean(axis='columns').max():.2f}, average {own}"


def papers(task: str, algorithm: str, sharing: str = SHARED) -> str:
    """The paper's maximum and average."""
    (maximum, error), (average, its_error) = (
        paper(name)[task, algorithm, sharing] for name in ("max_return", "average_return")
    )
    return f"the paper {maximum:.2f} ± {error:.2f}, {average:.2f} ± {its_error:.2f}"


def which_agree(counted: pd.DataFrame, task: str, algorithm: str, sharing: str) -> str:
    """Which of a cell's average and maximum agree with the paper's; no target, where neither is counted."""
    cells = counted[(counted["task"] == task) & (counted["algorithm"] == algorithm) & (counted["sharing"] == sharing)]
    agree = {*cells.loc[cells["agrees"], "metric"]}
    names = [name.split()[0] for metric, name in agreement.METRICS.items() if metric in agree]
    return f"agrees: {' and '.join(names) or 'neither'}" if len(cells) else "no target"


def maddpg(evaluations: pd.DataFrame, counted: pd.DataFrame, task: str, sharing: str = SHARED) -> str:
    """These evaluations of MADDPG on a task, beside the paper's, and which of the two cells agree."""
    here, theirs = beside_the_paper(evaluations, task, "maddpg", sharing), papers(task, "maddpg", sharing)
    said = which_agree(counted, task, "maddpg", sharing)
    return f"{task}{'' if sharing == SHARED else ', without sharing'}: {here}; {theirs}; {said}"


def padding() -> None:
    """MADDPG in foraging, beside the paper's."""
    for task in claims.SETS["lbf"]:
        print(maddpg(report().shown, report().counted, task))


def ends() -> None:
    """MADDPG as it is and as variants of its script, beside the paper's."""
    ablations = store.load(ABLATIONS)
    for task, sharing in ablations[["task", "sharing"]].drop_duplicates().itertuples(index=False, name=None):
        setting = setting_name(paper_setting(task))  # so that a variant counts as MADDPG
        print("as it is,", maddpg(report().shown, report().counted, task, sharing))
        for copy, words in (("maddpg_ends", "without the ends"), ("maddpg_epymarl", "as in EPyMARL")):
            variant = table(ablations, task, copy, sharing).assign(algorithm="maddpg", setting=setting)
            if len(variant):
                counted = agreement.counted(tables.compare(our_cells(variant), paper_cells()))
                print(f"{words},", maddpg(variant, counted, task, sharing))


def opponents() -> None:
    """The tasks against trained opponents: our runs against the paper's and against ours, beside the paper's values."""
    there = [(words, evaluations) for words, evaluations in (("its", report().shown), ("our", report().against_own))]
    for task, algorithm in itertools.product(TRAINED_AGAINST, ON_POLICY + OFF_POLICY):
        found = [papers(task, algorithm)]
        for whose, evaluations in there:
            if len(curves(evaluations, task, algorithm)):
                found.append(f"against {whose} opponent {beside_the_paper(evaluations, task, algorithm)}")
        print(f"{task}, {algorithm}: {'; '.join(found)}")
    for task in TRAINED_AGAINST:
        own = {name: curves(report().against_own, task, name).mean().mean() for name in ON_POLICY + OFF_POLICY}
        more = {name: own[name] - paper("average_return")[task, name, SHARED][0] for name in own}
        above = [difference for difference in more.values() if difference > 0]
        counted = report().counted
        counted = counted[(counted["task"] == task) & (counted["sharing"] == SHARED)]
        print(
            f"{task}: against our opponent {len(above)} of {len(own)} averages are above the paper's, by "
            f"{min(above):.1f} to {max(above):.1f}; against its opponent {agreement.numbers(counted['agrees'])} "
            "averages and maxima agree"
        )


def unshared() -> None:
    """Our runs in Tag without sharing, against the paper's prey, beside the paper's values."""
    for algorithm in ON_POLICY + OFF_POLICY:
        if len(ours("mpe-tag", algorithm, INDEPENDENT)):
            here = beside_the_paper(report().shown, "mpe-tag", algorithm, INDEPENDENT)
            said = which_agree(report().counted, "mpe-tag", algorithm, INDEPENDENT)
            print(f"{algorithm}: {papers('mpe-tag', algorithm, INDEPENDENT)}; ours: {here}; {said}")


def probes(*files: str) -> None:
    """What scripted teams earn against the opponents of this repository, or against the networks in these files."""
    import train_opponents

    import envs
    from envs.families import mpe

    networks = [*map(Path, files)] or [mpe.OPPONENTS / f"{task}.npz" for task in TRAINED_AGAINST]
    for task, network in zip(TRAINED_AGAINST, networks):
        settings = {**envs.task(f"{task}-selfplay").settings, "selfplay": False}
        for name, probe in train_opponents.PROBES[task].items():
            env = mpe.Env(task, train_opponents.EPISODES, 0, False, **settings, opponent=network)
            print(f"{task}, {name}: {train_opponents.mean_return(env, probe.act):.2f}")


def words(*directories: str) -> None:
    """Speaker-Listener: what a scripted listener earns, where the seeds end, how probable so many slow ones of MAA2C
    and MAPPO are beside none of the paper's (Fisher's exact test), and which five seeds the paper's IPPO and IA2C could
    be. Or, for the directories of such runs, what their speakers say."""
    if directories:
        for directory in directories:
            print(spoken(directory))
        return
    for number in (1, 2, 3):
        print(f"a scripted listener, {number} of 3 words: {told(number):.1f}")
    slow = []  # for each seed of MAA2C and MAPPO, whether it was below -18 in the second half
    for algorithm in ("ia2c", "ippo", "maa2c", "mappo"):
        steps = table(report().shown, "mpe-speaker-listener", algorithm)
        for seed, curve in ours("mpe-speaker-listener", algorithm).items():
            below = curve.index[curve < -18]
            last = steps[(steps["seed"] == seed) & (steps["point"] == below[-1])]["timestep"].iloc[0]
            if algorithm in ("maa2c", "mappo"):
                slow.append(last > 10e6)
            print(
                f"{algorithm}, seed {seed}: below -18 for the last time at {last / 1e6:.1f} million steps; "
                f"the last ten points {curve[-10:].mean():.1f}"
            )
    p = fisher_exact([[sum(slow), len(slow) - sum(slow)], [0, 2 * PAPER_SEEDS]]).pvalue
    print(
        f"maa2c and mappo: {sum(slow)} of {len(slow)} stayed for more than ten million steps; if none of the paper's "
        f"ten did, p = {p:.2f}"
    )
    for algorithm, sharing in (("maa2c", SHARED), ("mappo", SHARED), ("ia2c", INDEPENDENT)):
        print(f"{algorithm}, {SHARING[sharing]}: {with_more_seeds('mpe-speaker-listener', algorithm, sharing)}")
    for algorithm in ("ippo", "ia2c"):
        print(one_of_five("max_return", "mpe-speaker-listener", algorithm))


def one_of_five(metric: str, task: str, algorithm: str) -> str:
    """A cell of the paper with sharing, taken apart into four seeds that are equal and one that is lower."""
    mean, error = paper(metric)[task, algorithm, SHARED]
    x, y = mean + error / 2, mean - 2 * error  # (4 x + y) / 5 is the mean, 2 (x - y) / 5 the interval
    return f"{algorithm}: the paper's {mean:.2f} ± {error:.2f} could be four seeds at {x:.1f} and one at {y:.1f}"


def still() -> None:
    """What teams earn on mpe-spread whose agents all take one action throughout, in 10,000 episodes; COMA's evaluations
    beside them; and which five seeds the paper's COMA could be."""
    import envs

    def line(name: str, mean: float, deviation: float, contacts: float, occupied: float) -> None:
        print(
            f"{name}: return {mean:.0f} ± {deviation:.0f}; contacts {contacts:.2f}, occupied landmarks {occupied:.2f}"
        )

    env = envs.make("mpe-spread", 10_000)
    for action, name in enumerate(("stand still", "go right", "go left", "go up", "go down")):
        returns = np.zeros(env.num_envs)
        env.reset(seed=1)
        for _ in range(25):
            _, rewards, _, _, info = env.step(np.full((env.num_envs, 3), action))
            returns += rewards
        contacts, occupied = (info["statistics"][part].mean() for part in ("contacts", "occupied_landmarks"))
        line(f"all agents {name}", returns.mean(), returns.std(), contacts, occupied)
    points = table(report().shown, "mpe-spread", "coma")
    points = points[points["timestep"] >= 3e6]
    steps = (points["timestep"] / 1e6).map("at {:.0f} million steps".format)
    groups = points.groupby(steps.where(points["return_mean"] < -300, "its other points from 3 million steps on"))
    means = groups[["return_mean", "return_std", "contacts", "occupied_landmarks"]].mean().sort_values("return_mean")
    for name, figures in means.iterrows():
        line(f"coma, seed 0, {name}", *figures)
    print(one_of_five("average_return", "mpe-spread", "coma"))


def with_more_seeds(task: str, algorithm: str, sharing: str) -> str:
    """Whether a cell agrees with the paper's by its first seeds, and how its spread over seeds compares (F-test)."""
    curve = ours(task, algorithm, sharing)
    parts = []
    for metric, name in agreement.METRICS.items():
        mean, error = paper(metric)[task, algorithm, sharing]
        found = []
        for number in range(1, len(curve.columns) + 1):
            own, deviation = value(curve.iloc[:, :number], metric)
            width = agreement.half_width(interval(deviation, number), number, error)
            found.append("yes" if abs(own - mean) <= width else "no")
        ratio, number = deviation / (error * np.sqrt(PAPER_SEEDS) / 2), len(curve.columns)
        f_test = f_distribution(number - 1, PAPER_SEEDS - 1)
        p = 2 * min(f_test.sf(ratio**2), f_test.cdf(ratio**2))
        parts.append(
            f"{name.split()[0]} {own:.2f} ± {interval(deviation, number):.2f}, the paper {mean:.2f} ± {error:.2f}, "
            f"agrees with the first 1 to {number} seeds: {', '.join(found)}; spread {ratio:.1f} times the paper's, "
            f"p = {p:.4f}"
        )
    return "; ".join(parts)


def told(words: int) -> float:
    """What a listener earns in 20,000 episodes that goes to the middle of the landmarks which the speaker calls by the
    same word: with two words the second and the third, with one word all three."""
    import train_opponents

    import envs

    def act(game: Any, rng: np.random.Generator) -> Any:
        landmarks = game.landmark_position
        alone = landmarks[np.arange(len(game.goal)), game.goal]
        middle = landmarks[:, words - 1 :].mean(axis=1)
        place = np.where((game.goal < words - 1)[:, None], alone, middle)
        moves = train_opponents.towards_and_stay(game, 1, place[:, None])
        return np.insert(moves, 0, 0, axis=1)  # what the speaker says does not matter

    env: Any = envs.make("mpe-speaker-listener", 20_000)
    return train_opponents.mean_return(env, act)


def spoken(directory: str) -> str:
    """What the run's team earns for each goal, and the shares of the words its speaker says then, in 600 episodes."""
    import envs

    name = json.loads((Path(directory) / "config.json").read_text(encoding="utf-8"))["algorithm"]
    team = script(ALGOS / f"{name}.py").load(directory)
    env = envs.make("mpe-speaker-listener", 600)
    observations, info = env.reset(seed=1)
    goals = observations[:, 0, :3].argmax(axis=1)  # the speaker sees a colour, each brightest in one channel
    returns, said = np.zeros(600), np.zeros((600, 3))
    for _ in range(25):
        actions = team.act(observations, info)
        said[np.arange(600), actions[:, 0]] += 1
        observations, rewards, _, _, info = env.step(actions)
        returns += rewards
    parts = [f"{name}: return {returns.mean():.1f}"]
    for goal in range(3):
        shares = ", ".join(f"{100 * share:.0f} %" for share in said[goals == goal].mean(axis=0) / 25)
        parts.append(f"goal {goal + 1}: {returns[goals == goal].mean():.1f}, words {shares}")
    return "; ".join(parts)


def standardised() -> None:
    """What a long victory and a short defeat are worth on smaclite-3s_vs_5z-sc2, with rewards as they are and
    standardised by the mean and the standard deviation of the defeats' steps; and where QMIX ends with both."""
    import battles

    task = "smaclite-3s_vs_5z-sc2"
    rewards = {
        "a short defeat": rewards_of_battles(task, battles.attack_nearest),
        "a long victory": rewards_of_battles(task, battles.kite),
    }
    print_worth(rewards, "a short defeat")
    curve = table(report().shown, task, "qmix")
    curve = curve[curve["seed"] == 0]
    last = curve.sort_values("point").iloc[-1]
    print(
        f"qmix, seed 0: return {last['return_mean']:.1f} in {last['episode_length']:.0f} steps at the end, "
        f"{last['dead_allies']:.1f} of its 3 units dead; at its best {curve['return_mean'].max():.1f}; ",
        end="",
    )
    print("the paper's best {:.2f} ± {:.2f}".format(*paper("max_return")["smac-3s_vs_5z", "qmix", SHARED]))
    plain = table(report().evaluations, task, "qmix")
    changed = {"reward_standardisation": False, "total_timesteps": 400_000}
    last = plain[plain["setting"] == setting_name(changed)].sort_values("point").iloc[-1]
    print(
        f"qmix, seed 0, not standardised, after 400,000 steps: return {last['return_mean']:.1f} in "
        f"{last['episode_length']:.0f} steps, {last['dead_allies']:.1f} of its 3 units dead, "
        f"{100 * last['battle_won']:.0f} % of the battles won"
    )


def rewards_of_battles(task: str, policy: Any) -> NDArray[np.float64]:
    """A scripted team's rewards [time, battle] in 100 battles, NaN after a battle's end."""
    import envs

    env: Any = envs.make(task, 100, seed=0)
    env.reset()
    rng, steps, going = np.random.default_rng(0), [], np.ones(100, bool)
    while going.any():
        _, reward, terminated, truncated, _ = env.step(policy(env, rng))
        steps.append(np.where(going, reward, np.nan))
        going = ~(terminated | truncated)
    return np.array(steps, float)


def print_worth(rewards: dict[str, NDArray[np.float64]], measure: str) -> None:
    """What teams earn, from their rewards [time, battle]: as they are, and standardised by one team's steps."""
    played = rewards[measure][~np.isnan(rewards[measure])]
    for name, x in rewards.items():
        discount = 0.99 ** np.arange(len(x))[:, None]
        worth = [np.nansum(discount * y, axis=0).mean() for y in (x, (x - played.mean()) / played.std(ddof=1))]
        print(
            f"{name}: return {np.nansum(x, axis=0).mean():.1f} in {(~np.isnan(x)).sum(axis=0).mean():.0f} steps, "
            f"discounted {worth[0]:.1f}, standardised and discounted {worth[1]:.1f}"
        )


def flight(directory: str = "") -> None:
    """IPPO on smaclite-2s_vs_1sc-sc2 and COMA on smaclite-3s_vs_5z-sc2-v2: when our teams stayed away from the enemy
    until the battle's last step, which a return of 0 tells, beside the paper's maximum and average. Or, for the
    directory of such a run of IPPO, what its critics say of that."""
    if directory:
        print(value_of_flight(directory))
        return
    for name, rules, algorithm in (("2s_vs_1sc", "sc2", "ippo"), ("3s_vs_5z", "sc2-v2", "coma")):
        for seed, points in table(report().shown, f"smaclite-{name}-{rules}", algorithm).groupby("seed"):
            away = points[points["return_mean"] < 0.1]["timestep"] / 1e6
            when = f", the first at {away.min():.0f}, the last at {away.max():.0f} million steps" if len(away) else ""
            won = 100 * points.set_index("point").loc[1, "battle_won"]
            print(
                f"{algorithm} on {name}, seed {seed}: {won:.0f} % of the battles won at 1 million steps; return below "
                f"0.1 at {len(away)} of {len(points)} points{when}; average {points['return_mean'].mean():.2f}, of the "
                f"last ten {points['return_mean'][-10:].mean():.2f}"
            )
        for sharing, words in SHARING.items():
            print(f"{papers(f'smac-{name}', algorithm, sharing)}, {words}")


def value_of_flight(directory: str) -> str:
    """Means over 20 battles of the run's team, over the steps of agents that live and cannot attack."""
    import ippo
    import torch

    from envs import runs

    saved = runs.read_checkpoint(directory, "ippo")
    args = ippo.Args(**saved["config"]["flags"])
    env = runs.make_for(args, 20, 0)
    batch, returns = ippo.collect(args, env, ippo.load(directory), ippo.new_storage(args, env))
    earned = torch.zeros(len(batch.played) + 1, *batch.rewards.shape[1:])  # from each step to the battle's end
    for t in reversed(range(len(batch.played))):
        earned[t] = torch.where(batch.played[t, :, None], batch.rewards[t] + args.gamma * earned[t + 1], 0.0)
    no_op, attack = batch.action_masks[:-1, ..., 0], batch.action_masks[:-1, ..., 6]
    alive = batch.played[..., None] & ~no_op
    away = alive & ~attack
    worth = {}
    for name in ("critic", "target_critic"):
        critic = ippo.MultiAgentNetwork(args, env.n_agents, env.obs_size, 1)
        critic.load_state_dict(saved["parts"][name])
        with torch.no_grad():
            worth[name] = critic(batch.observations[:-1])[0].squeeze(-1)[away].mean()
    return (
        f"return {returns.mean():.2f}, no enemy in range in {100 * away.sum() / alive.sum():.0f} % of the steps; there "
        f"the critic says {worth['critic']:.2f} and its target {worth['target_critic']:.2f}, and the team still earns "
        f"{earned[:-1].expand(away.shape)[away].mean():.2f}, discounted"
    )


def certain() -> None:
    """COMA in the battles: what it earns beside the paper's and beside a scripted team that attacks the nearest enemy.
    How it does on smaclite-3s5z-sc2-v2 without standardised rewards, and how IA2C and MAA2C do there."""
    import battles

    import envs

    for name, rules in (("2s_vs_1sc", "sc2"), ("3s_vs_5z", "sc2-v2"), ("3s5z", "sc2-v2")):
        task = f"smaclite-{name}-{rules}"
        curve = table(report().shown, task, "coma").sort_values("point")
        env: Any = envs.make(task, 100, seed=0)
        played = battles.play(env, battles.attack_nearest)
        share, error = paper("max_win_rate")[f"smac-{name}", "coma", SHARED]
        print(
            f"{task}, coma: {beside_the_paper(report().shown, task, 'coma')}, at the end "
            f"{curve['return_mean'].iloc[-1]:.2f}, at best {100 * curve['battle_won'].max():.0f} % of the battles won; "
            f"{papers(f'smac-{name}', 'coma')}, won {100 * share:.0f} ± {100 * error:.0f} %; "
            f"a team that attacks the nearest {played['return'].mean():.2f}"
        )
    task = "smaclite-3s5z-sc2-v2"
    plain = table(report().evaluations, task, "coma")
    changed = {"eval_points": 6, "reward_standardisation": False, "total_timesteps": 5_000_000}
    last = plain[plain["setting"] == setting_name(changed)].sort_values("point").iloc[-1]
    print(
        f"{task}, coma, not standardised, after 5 million steps: return {last['return_mean']:.2f}, "
        f"{100 * last['battle_won']:.0f} % of the battles won"
    )
    for algorithm in ("ia2c", "maa2c"):
        curve = table(report().shown, task, algorithm).sort_values("point")
        win = curve["battle_won"].to_numpy() >= 0.9
        print(
            f"{task}, {algorithm}: {beside_the_paper(report().shown, task, algorithm)}; "
            f"{papers('smac-3s5z', algorithm)}; at least 90 % of the battles won at {win[1:21].sum()} of the first "
            f"20 points after the start, and at {win[21:].sum()} of the last 20"
        )


def corridor(directory: str = "") -> None:
    """smaclite-corridor-sc2-v2: what IA2C and MAA2C learn, with and without standardised rewards, beside the paper's,
    and what two scripted teams earn. Or, for the run directory of IA2C, what its team and these two earn when rewards
    are standardised as its own."""
    import battles

    import envs

    task = "smaclite-corridor-sc2-v2"
    scripted = {
        "a team that attacks the nearest": battles.attack_nearest,
        "a team that waits": battles.wait_at(14.5, 19),
    }
    if directory:
        rewards = {name: rewards_of_battles(task, policy) for name, policy in scripted.items()}
        print_worth({"IA2C's team": rewards_of_ia2c(directory)} | rewards, "IA2C's team")
        return
    changed = {"eval_points": 4, "reward_standardisation": False, "total_timesteps": 3_000_000}
    for algorithm in ("ia2c", "maa2c"):
        curve = table(report().shown, task, algorithm)
        plain = table(report().evaluations, task, algorithm)
        plain = plain[plain["setting"] == setting_name(changed)]
        share, error = paper("max_win_rate")["smac-corridor", algorithm, SHARED]
        print(
            f"{algorithm}: {beside_the_paper(report().shown, task, algorithm)}, at best "
            f"{100 * curve['battle_won'].max():.0f} % of the battles won; {papers('smac-corridor', algorithm)}, won "
            f"{100 * share:.0f} ± {100 * error:.0f} %"
        )
        for each, runs in (("standardised", curve), ("not standardised", plain)):
            there = runs[runs["timestep"] < 3_100_000].sort_values("point").iloc[-1]
            print(
                f"{algorithm}, {each}, after 3 million steps: return {there['return_mean']:.2f} in "
                f"{there['episode_length']:.0f} steps"
            )
    for name, policy in scripted.items():
        env: Any = envs.make(task, 100, seed=0)
        played = battles.play(env, policy)
        print(
            f"{name}: return {played['return'].mean():.2f} in {played['length'].mean():.0f} steps, "
            f"{100 * played['win'].mean():.0f} % of the battles won"
        )


def rewards_of_ia2c(directory: str) -> NDArray[np.float64]:
    """Rewards [time, battle] of a team of IA2C in 100 battles, NaN after a battle's end."""
    import ia2c

    from envs import runs

    args = ia2c.Args(**runs.read_checkpoint(directory, "ia2c")["config"]["flags"])
    env = runs.make_for(args, 100, 0)
    batch, _ = ia2c.collect(args, env, ia2c.load(directory), ia2c.new_storage(args, env))
    return np.where(batch.played, batch.rewards[..., 0], np.nan)


def fall(file: str = "") -> None:
    """Runs on RWARE, with sharing, that fell far between two points. Or, for the file of an update of MAPPO that was
    saved as the page says, what the update made of the team."""
    if file:
        for line in updated(file):
            print(line)
        return
    shown = report().shown.sort_values("point")
    shown = shown[(shown["family"] == "rware") & (shown["sharing"] == SHARED)]
    runs = shown.groupby(["task", "algorithm", "seed"]).filter(lambda points: points["return_mean"].max() >= 1)
    runs = runs.groupby(["task", "algorithm", "seed"])
    print(
        f"RWARE: in {len(runs)} runs the best return is at least 1. Falls by more than half of it between two points:"
    )
    for (task, algorithm, seed), points in runs:
        returns, steps = points["return_mean"].to_numpy(), points["timestep"].to_numpy() / 1e6
        for k in np.flatnonzero(-np.diff(returns) > returns.max() / 2):
            print(
                f"{algorithm} on {task}, seed {seed}: {returns[k]:.2f} at {steps[k]:.0f} million steps, "
                f"{returns[k + 1]:.2f} at {steps[k + 1]:.0f}, {returns[-1]:.2f} at the end; best {returns.max():.2f}"
            )


def updated(file: str) -> Iterator[str]:
    """What the update made of the team: returns over 100 episodes, and in how many of the batch's decisions more than
    half of the probability moved to other actions. Then 20 times the 15 updates from this one on, with other random
    numbers: how often the mean return of three batches in a row fell below half of what it was, with these updates and
    with milder ones.
    """
    import mappo
    import torch

    from envs import runs

    torch.set_num_threads(1)  # as in a run
    flags, n_updates, states, batch = torch.load(file)
    args, batch = mappo.Args(**flags), mappo.Batch(*batch)

    def start(num_envs: int, seed: int) -> tuple[Any, Any, dict[str, Any]]:
        """A game, the team as it was before the update, and all that learns."""
        env = runs.make_for(args, num_envs, seed)
        env.reset()
        agents = mappo.MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
        critics = [mappo.MultiAgentNetwork(args, env.n_agents, env.state_size, 1) for _ in range(2)]
        optimisers = [torch.optim.Adam(network.parameters(), fused=True) for network in (agents, critics[0])]
        parts: dict[str, Any] = dict(zip(states, (agents, *critics, *optimisers), strict=True))
        for name, part in parts.items():
            part.load_state_dict(deepcopy(states[name]))  # Adam would go on in these very tensors
        return env, mappo.Team(args, agents, torch.Generator().manual_seed(seed)), parts

    def played(env: Any, team: Any) -> Any:
        return mappo.collect(args, env, team, mappo.new_storage(args, env))

    def probabilities(agents: Any) -> Any:
        with torch.no_grad():
            return mappo.log_probabilities(agents(batch.observations[:-1])[0], batch.action_masks[:-1]).exp()

    env, team, parts = start(100, 0)
    before, first = probabilities(team.agents), played(env, team)[1].mean()
    yield f"before the update: return {first:.1f}"
    env, team, parts = start(100, 0)
    mappo.update(args, parts, batch, n_updates)
    moved = (probabilities(team.agents) - before).abs().sum(-1) / 2
    changed = f"{(moved > 0.5).sum()} of {moved.numel()} decisions changed"
    yield f"after it: return {played(env, team)[1].mean():.1f}; {changed}"
    one_epoch = dataclasses.replace(args, update_epochs=1)
    for words, settings, share in (
        ("15 updates from here on", args, 1.0),
        ("with one epoch", one_epoch, 1.0),
        ("at half the learning rate", args, 0.5),
    ):
        fallen = 0
        for seed in range(20):
            env, team, parts = start(args.num_envs, seed)
            for name in ("actor_optimiser", "critic_optimiser"):
                parts[name].param_groups[0]["lr"] *= share
            returns = []
            for k in range(15):
                seen, each = played(env, team)
                mappo.update(settings, parts, seen, n_updates + k)
                returns.append(each.mean())
            fallen += np.convolve(returns, np.ones(3) / 3, "valid").min() < first / 2
        yield f"{words}: {fallen} of 20 fell below half of the return"


def parted() -> None:
    """The claims that the paper's tables support and our results do not, with the figures of both."""
    for claim, theirs, here in report().verdicts():
        if (theirs.verdict, here.verdict) == (claims.HOLDS, claims.FAILS):
            print(f"{claim.sentence}\n  the paper: {theirs.figures}\n  ours: {here.figures}")


PARTS: dict[str, Callable[..., None]] = {
    f.__name__: f
    for f in (
        *(departures, new_seeds, updates, causes, identical, length, climbing, untrained, impossible, exchanged),
        *(padding, ends, standardised, opponents, unshared, probes, words, still),
        *(flight, certain, corridor, fall, parted),
    )
}


def filled(page: str) -> str:
    """A page with the present figures of all its parts."""

    def block(shown: re.Match[str]) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            PARTS[shown[2]]()
        return f"{shown[1]}{printed.getvalue()}```"

    command = r"(\$ python tools/paper_run_again\.py (\w+)\n).*?```"
    return re.sub(command, block, page, flags=re.DOTALL)


if __name__ == "__main__":
    if sys.argv[1:] == ["page"]:
        for page in PAGES:
            page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
        sys.exit()
    if (
        len(sys.argv) < 2
        or sys.argv[1] not in PARTS
        or (len(sys.argv) > 2 and sys.argv[1] not in ("probes", "words", "flight", "corridor", "fall"))
    ):
        sys.exit(__doc__)
    PARTS[sys.argv[1]](*sys.argv[2:])
