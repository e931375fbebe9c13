"""Makes docs/data/<algorithm>-<healthy|sick>.csv: what TensorBoard shows of the two runs on each algorithm's page.

    python tools/recordings.py [<algorithm> ...]

docs/data/runs.csv has the flags of each run. A run is made in runs/site/; one that is there goes on.
"""

import argparse
import csv
import shlex
import subprocess
import sys
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data"
TASK = "lbf-8x8-2p-2f"
POINTS = 60  # of a curve; each is the mean of as many neighbours


def train(algorithm: str, health: str, flags: str) -> Path:
    """Trains with these flags. Returns the run's directory."""
    directory = ROOT / "runs" / "site" / f"{algorithm}-{health}"
    script = str(ROOT / "algos" / f"{algorithm}.py")
    command = [sys.executable, script, "--env", TASK, *shlex.split(flags), "--run-dir", str(directory), "--resume"]
    subprocess.run(command, check=True)
    return directory


def scalars(directory: Path) -> list[tuple[str, int, float]]:
    """What TensorBoard shows of a run: tag, timestep, value."""
    events = EventAccumulator(str(directory), size_guidance={"scalars": 0})
    events.Reload()
    rows = []
    for tag in sorted(events.Tags()["scalars"]):
        points = events.Scalars(tag)
        width = -(-len(points) // POINTS)
        for start in range(0, len(points), width):
            chunk = points[start : start + width]
            rows.append((tag, chunk[-1].step, sum(point.value for point in chunk) / len(chunk)))
    return rows


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("algorithms", nargs="*", help="default: all")
    chosen = parser.parse_args().algorithms
    with open(DATA / "runs.csv", newline="", encoding="utf-8") as file:
        runs = list(csv.DictReader(file))
    for run in runs:
        if chosen and run["algorithm"] not in chosen:
            continue
        directory = train(run["algorithm"], run["health"], run["flags"])
        with open(DATA / f"{directory.name}.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["tag", "timestep", "value"])
            writer.writerows((tag, step, f"{value:.4g}") for tag, step, value in scalars(directory))
        print(directory.name, flush=True)


if __name__ == "__main__":
    main()
