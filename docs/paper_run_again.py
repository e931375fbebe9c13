"""The figures of the page "The paper, run again", from the paper's tables, benchmark/results and the battles.

    python docs/paper_run_again.py opponents

The parts are length, climbing, untrained, impossible, padding, standardised, opponents, words and parted.

A test holds the page's figures against what this prints.
"""

import itertools
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
BENCHMARK = ROOT / "benchmark"
ON_POLICY = ["ia2c", "ippo", "coma", "maa2c", "mappo"]
OFF_POLICY = ["iql", "vdn", "qmix", "maddpg"]
MATRIX = ["matrix-climbing", *(f"matrix-penalty-{k}" for k in (0, 25, 50, 75, 100))]


def ours(task: str, algorithm: str, sharing: str) -> pd.DataFrame:
    """The returns of one of our tables: [point, seed]."""
    rows = pd.read_csv(BENCHMARK / "results" / task / f"{algorithm}-{sharing}.csv")
    return rows.pivot(index="point", columns="seed", values="return_mean")


def paper(metric: str) -> dict[tuple[str, str, str], tuple[float, float]]:
    """(task, algorithm, sharing) -> (mean, interval) of one of the paper's tables."""
    rows = pd.read_csv(BENCHMARK / "paper" / "returns.csv")
    rows = rows[rows["metric"] == metric]
    sharing = rows["parameter_sharing"].map({"yes": "shared", "no": "independent"})
    keys = zip(rows["task"], rows["algorithm"], sharing)
    return dict(zip(keys, zip(rows["mean"], rows["ci95"])))


def interval(values: np.ndarray) -> float:
    """2 s / sqrt(n), as in the paper."""
    return 2 * float(np.std(values, ddof=1)) / len(values) ** 0.5


def length() -> None:
    """Average returns of the matrix games beside the paper's, if only the first points count."""
    theirs = paper("average_return")
    for name, algorithms in (("on-policy", ON_POLICY), ("off-policy", OFF_POLICY)):
        for points in (101, 90, 84, 80):
            differences = []
            for task, algorithm, sharing in itertools.product(MATRIX, algorithms, ("shared", "independent")):
                mean, error = theirs[task, algorithm, sharing]
                seeds = ours(task, algorithm, sharing).iloc[:points].mean().to_numpy()
                both = max(np.hypot(error, interval(seeds)), 0.01)
                differences.append((seeds.mean() - mean) / both)
            inside = np.sum(np.abs(differences) <= 1)
            print(
                f"{name}, the first {points} points: {inside} of {len(differences)} averages within both intervals, "
                f"root mean square {np.sqrt(np.mean(np.square(differences))):.1f} intervals"
            )


def impossible() -> None:
    """Cells of the paper in which the average over training is above the maximum."""
    averages, maxima = paper("average_return"), paper("max_return")
    names = {}
    for key in maxima:
        if key in averages and averages[key][0] > maxima[key][0] + 0.005:
            task, algorithm, sharing = key
            names.setdefault((sharing, task), []).append(
                f"{algorithm} {averages[key][0]:.2f} over {maxima[key][0]:.2f}"
            )
    for (sharing, task), cells in names.items():
        print(f"{task}, {sharing}: {', '.join(cells)}")
    print(f"{sum(map(len, names.values()))} cells")


def untrained() -> None:
    """What the networks of the matrix games return before training, where the paper's maximum lies there."""
    maxima = paper("max_return")
    for algorithm in ("iql", "vdn", "qmix"):
        for task, sharing in (("matrix-climbing", "shared"), ("matrix-penalty-100", "independent")):
            table = ours(task, algorithm, sharing)
            first = ", ".join(f"{x:.0f}" for x in sorted(table.iloc[0]))
            last = ", ".join(f"{x:.0f}" for x in sorted(table.iloc[-1]))
            mean, error = maxima[task, algorithm, sharing]
            print(f"{algorithm}, {task}, {sharing}: before training {first}; at the end {last}; ", end="")
            print(f"the paper's maximum {mean:.2f} ± {error:.2f}")


def climbing() -> None:
    """Which returns of five seeds give the 175 ± 54.77 of the paper's VDN and QMIX, if both agents act alike."""
    for name, payoffs in (("as we have the rows", (11, 7, 5)), ("as they are printed", (0, 7, 0))):
        found = []
        for seeds in itertools.combinations_with_replacement(sorted({25 * x for x in payoffs}), 5):
            if abs(np.mean(seeds) - 175) < 0.01 and abs(interval(np.array(seeds)) - 54.77) < 0.01:
                found.append(seeds)
        print(f"{name}: {', '.join(map(str, found)) or 'none'}")


def beside_the_paper(task: str, algorithm: str) -> str:
    """Our returns on one task with sharing, and the paper's intervals."""
    key = task, algorithm, "shared"
    curve = ours(*key).mean(axis="columns")
    (maximum, error), (average, its_error) = paper("max_return")[key], paper("average_return")[key]
    return (
        f"{task}, {algorithm}: maximum {curve.max():.2f}, the paper {maximum:.2f} ± {error:.2f}; "
        f"average {curve.mean():.2f}, the paper {average:.2f} ± {its_error:.2f}"
    )


def padding() -> None:
    """MADDPG in foraging, beside the paper's."""
    for file in sorted((BENCHMARK / "results").glob("lbf-*/maddpg-shared.csv")):
        print(beside_the_paper(file.parent.name, "maddpg"))


def opponents() -> None:
    """The tasks against trained opponents: our seeds beside the paper's intervals."""
    for task, algorithm in itertools.product(("mpe-adversary", "mpe-tag"), ON_POLICY + OFF_POLICY):
        averages = ", ".join(f"{x:.2f}" for x in ours(task, algorithm, "shared").mean())
        print(f"{beside_the_paper(task, algorithm)}; our seeds' averages {averages}")


def words() -> None:
    """Speaker-Listener, if one of the paper's five seeds stays at y and the others reach x: then the mean is
    (4 x + y) / 5 and the interval 2 (x - y) / 5."""
    for algorithm in ("ippo", "ia2c"):
        mean, error = paper("max_return")["mpe-speaker-listener", algorithm, "shared"]
        x, y = mean + error / 2, mean - 2 * error
        seed = ours("mpe-speaker-listener", algorithm, "shared")[0]
        print(
            f"{algorithm}: the paper's {mean:.2f} ± {error:.2f} are four seeds at {x:.1f} and one at {y:.1f}; "
            f"our seed over the last ten points {seed[-10:].mean():.1f}"
        )


def standardised() -> None:
    """What a long victory and a short defeat are worth on smaclite-3s_vs_5z-sc2, with rewards as they are and
    standardised by the mean and the standard deviation of the defeats' steps."""
    sys.path.insert(0, str(ROOT / "tests"))
    import battles

    import envs

    rewards = {}
    for name, policy in (("a short defeat", battles.attack_nearest), ("a long victory", battles.kite)):
        env = envs.make("smaclite-3s_vs_5z-sc2", 100, seed=0)
        env.reset()
        rng, steps, going = np.random.default_rng(0), [], np.ones(100, bool)
        while going.any():
            _, reward, terminated, truncated, _ = env.step(policy(env, rng))
            steps.append(np.where(going, reward, np.nan))
            going = ~(terminated | truncated)
        rewards[name] = np.array(steps, float)  # [time, battle], NaN after the end
    played = rewards["a short defeat"][~np.isnan(rewards["a short defeat"])]
    for name, x in rewards.items():
        discount = 0.99 ** np.arange(len(x))[:, None]
        worth = [np.nansum(discount * y, axis=0).mean() for y in (x, (x - played.mean()) / played.std(ddof=1))]
        print(
            f"{name}: return {np.nansum(x, axis=0).mean():.1f} in {(~np.isnan(x)).sum(axis=0).mean():.0f} steps, "
            f"discounted {worth[0]:.1f}, standardised and discounted {worth[1]:.1f}"
        )


def parted() -> None:
    """The claims that the paper's tables support and our results do not, with the figures of both."""
    sys.path.insert(0, str(BENCHMARK))
    from reporting import claims
    from reporting.results import RESULTS, load, our_cells, paper_cells

    both = zip(claims.CLAIMS, claims.judge(paper_cells()), claims.judge(our_cells(load(RESULTS))))
    for (_, sentence, _), theirs, here in both:
        if (theirs.verdict, here.verdict) == (claims.HOLDS, claims.FAILS):
            print(f"{sentence}\n  the paper: {theirs.figures}\n  ours: {here.figures}")


PARTS: dict[str, Callable[[], None]] = {
    f.__name__: f for f in (length, climbing, untrained, impossible, padding, standardised, opponents, words, parted)
}

if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in PARTS:
        sys.exit(__doc__)
    PARTS[sys.argv[1]]()
