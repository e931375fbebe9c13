"""Collects complete runs into benchmark/results/, one table for all seeds of a task, algorithm and setting.

    python benchmark/collect.py [runs]

    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].csv     the seeds' evaluations, a column seed
    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].json    their flags; where each seed was made

A run is complete when its last evaluation stands at its budget. Seeds that a table already has and that are no longer
in the runs folder stay in it. A budget other than the paper's is part of the name, as every other changed flag is. All
seeds of a table have equally many evaluations: a run that was lengthened keeps its old distances, and may not fit.
"""

import argparse
import csv
import json
import sys
from pathlib import Path

import envs

RESULTS = Path(__file__).resolve().parent / "results"
PER_RUN = {"seed", "run_dir", "resume", "watch", "track", "device", "threads"}  # flags that are not part of a setting
SECONDS = ("wall_seconds", "cpu_seconds")
ON_POLICY = ("ia2c", "ippo", "coma", "maa2c", "mappo")


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a table, none where there is no file."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def read_run(directory: Path) -> tuple[Path, dict, list[dict[str, str]]] | None:
    """Where the results of a run belong (no suffix), its config, its rows; None for a run that is not complete."""
    rows = read_csv(directory / "evaluations.csv")
    if not rows:
        return None
    config = json.loads((directory / "config.json").read_text())
    flags = config["flags"]
    if int(rows[-1]["timestep"]) < flags["total_timesteps"]:
        return None
    name = directory.parent.name
    task = envs.task(flags["env"])
    budget = task.on_policy_timesteps if name.split("-")[0] in ON_POLICY else task.off_policy_timesteps
    if flags["total_timesteps"] != budget:
        name += f"-total-timesteps={flags['total_timesteps']}"
    return RESULTS / directory.parent.parent.name / name, config, rows


def add(target: Path, config: dict, rows: list[dict[str, str]]) -> None:
    """Puts one seed into its table and settings. Raises ValueError where it differs from the other seeds in its flags
    or in the number of its evaluations."""
    seed = config["flags"]["seed"]
    flags = {name: value for name, value in config["flags"].items() if name not in PER_RUN}
    origin = {name: value for name, value in config.items() if name not in ("flags", "command")}
    settings_path, table_path = Path(f"{target}.json"), Path(f"{target}.csv")
    settings = json.loads(settings_path.read_text()) if settings_path.exists() else {"flags": flags, "seeds": {}}
    if settings["flags"] != flags:
        names = flags.keys() | settings["flags"].keys()
        changed = sorted(name for name in names if settings["flags"].get(name) != flags.get(name))
        raise ValueError(f"{table_path} was made with another {', '.join(changed)}")
    settings["seeds"] = dict(sorted({**settings["seeds"], str(seed): origin}.items(), key=lambda item: int(item[0])))
    table = [row for row in read_csv(table_path) if int(row["seed"]) != seed]
    if table and len(table) != len(rows) * len({row["seed"] for row in table}):
        raise ValueError(f"it has {len(rows)} evaluations, unlike the seeds in {table_path}")
    table += [{"seed": str(seed), **row} for row in rows]
    table.sort(key=lambda row: (int(row["seed"]), int(row["point"])))

    target.parent.mkdir(parents=True, exist_ok=True)
    with open(table_path, "w", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, **{name: f"{float(row[name]):.1f}" for name in SECONDS}} for row in table)
    settings_path.write_text(json.dumps(settings, indent=2) + "\n")


def main() -> None:
    """Collects what is complete, and says what was left out. Exit code 2 if something is wrong with a run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="?", type=Path, default=Path("runs"))
    runs = parser.parse_args().runs
    paths, wrong = sorted(runs.glob("*/*/seed*")), False
    if not paths:
        parser.error(f"there are no runs in {runs}")
    for path in paths:
        try:
            if found := read_run(path):
                add(*found)
                print(f"{path}: in {found[0].relative_to(RESULTS.parent.parent)}.csv")
            else:
                print(f"{path}: not complete, left out")
        except (ValueError, OSError) as error:  # an unknown task, other flags, a file that is missing or damaged
            print(f"{path}: left out, {error}", file=sys.stderr)
            wrong = True
    if wrong:
        sys.exit(2)


if __name__ == "__main__":
    main()
