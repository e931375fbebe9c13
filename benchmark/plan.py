"""What a campaign is to run: the runs, the grids of flags, and what is left of a run that was begun before."""

import csv
import itertools
import json
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import envs
import training
from envs.runs import changed_flags, is_whole, parse_flags
from results import table_path

Flags = tuple[str, ...]
GRID_COLUMNS = ["algorithms", "families", "flag", "values"]
OF_THIS_PROGRAM = ["env", "parameter_sharing", "seed", "run_dir", "resume", "watch"]  # flags that it gives itself


@dataclass(frozen=True)
class Run:
    """One run of a script.

    flags: for the script, beyond task, seed and sharing. changed: the flags that differ from the paper's, by name, as
    the run's config.json has them. directory: where it is kept.
    """

    algorithm: str
    task: str
    sharing: bool
    seed: int
    flags: Flags
    changed: dict[str, Any]
    total_timesteps: int
    directory: Path

    def __str__(self) -> str:
        return f"{self.directory.parent.parent.name} {self.directory.parent.name} seed {self.seed}"

    def arguments(self) -> list[str]:
        """The script's command line, without its directory."""
        return ["--seed", str(self.seed), *script_flags(self.task, self.sharing, self.flags)]


def script_flags(task: str, sharing: bool, flags: Flags) -> list[str]:
    """The flags that decide what a script trains, but for the seed."""
    return ["--env", task, "--parameter-sharing" if sharing else "--no-parameter-sharing", *flags]


def chosen_algorithms(words: list[str]) -> list[str]:
    """The scripts with these names; "all": every one. InputError for a name that is none."""
    names = training.script_names()
    for word in words:
        if word not in (*names, "all"):
            raise envs.InputError(f"unknown algorithm {word!r}; there are {', '.join(names)}.")
    return list(dict.fromkeys(name for word in words for name in (names if word == "all" else [word])))


def chosen_tasks(words: list[str]) -> list[str]:
    """Tasks by name, by family, or "all" of the paper's. InputError for a word that is none of these."""
    by_family: dict[str, list[str]] = {"all": envs.task_names()}
    for name in envs.task_names():
        by_family.setdefault(envs.task(name).family, []).append(name)
    tasks: list[str] = []
    for word in words:
        tasks += by_family.get(word) or [envs.task(word).name]
    return list(dict.fromkeys(tasks))


@dataclass(frozen=True)
class GridLine:
    """The values that a search tries for a flag, for these algorithms and families of tasks."""

    algorithms: list[str]
    families: list[str]
    flag: str
    values: list[str]


def read_grid(path: Path) -> list[GridLine]:
    """A grid: columns algorithms, families, flag, values; several words in a cell are separated by spaces.

    Every combination of the values of those lines that name an algorithm and the task's family is one variant.
    InputError where the file cannot be read or is not of this form.
    """
    try:
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise envs.InputError(f"{path} cannot be read: {error}") from None
    if not rows or any(list(row) != GRID_COLUMNS or None in row.values() for row in rows):
        raise envs.InputError(f"{path} is not a grid: its columns must be {', '.join(GRID_COLUMNS)}.")
    if empty := [row["flag"] for row in rows if not row["flag"].strip() or not row["values"].split()]:
        raise envs.InputError(f"{path} has a line without a flag or without values: {', '.join(empty)}.")
    return [
        GridLine(row["algorithms"].split(), row["families"].split(), row["flag"].strip(), row["values"].split())
        for row in rows
    ]


def variants(grid: list[GridLine], algorithm: str, family: str) -> Iterator[Flags]:
    """Every combination of values that the grid has for an algorithm on tasks of a family, as flags for the script."""
    choices: dict[str, list[str]] = {}
    for line in grid:
        if algorithm in line.algorithms and family in line.families:
            if (flag := line.flag.replace("-", "_")) in choices:
                raise envs.InputError(f"the grid has two lines of {flag} for {algorithm} on tasks of {family}.")
            choices[flag] = line.values
    for values in itertools.product(*choices.values()):
        yield tuple(word for flag, value in zip(choices, values) for word in written(flag, value))


def written(flag: str, value: str) -> list[str]:
    """A flag as one writes it on the command line."""
    name = flag.replace("_", "-")
    if value in ("true", "false"):
        return [f"--{name}" if value == "true" else f"--no-{name}"]
    return [f"--{name}", value]


def make_plan(
    algorithms: list[str],
    tasks: list[str],
    sharings: list[bool],
    seeds: int,
    flags: Flags,
    grid: list[GridLine] | None,
    runs: Path,
) -> list[Run]:
    """The runs of a campaign, all of the first seed first. InputError where a script refuses the flags."""
    settings = []
    for task, algorithm, sharing in itertools.product(tasks, algorithms, sharings):
        family = envs.task(task).family
        chosen = [()] if grid is None else list(variants(grid, algorithm, family))
        if chosen == [()] and grid is not None:
            raise envs.InputError(f"the grid has no line for {algorithm} on tasks of the family {family}.")
        settings += [make_setting(algorithm, task, sharing, (*variant, *flags), runs) for variant in chosen]
    plan = [
        Run(**setting, seed=seed, directory=folder / f"seed{seed}")
        for seed in range(seeds)
        for setting, folder in settings
    ]
    return list({run.directory: run for run in plan}.values())


def make_setting(algorithm: str, task: str, sharing: bool, flags: Flags, runs: Path) -> tuple[dict[str, Any], Path]:
    """What all seeds of a setting have in common, and their folder."""
    for word in flags:
        name = word.partition("=")[0].removeprefix("--").replace("-", "_").removeprefix("no_")
        if word.startswith("--") and name in OF_THIS_PROGRAM:
            raise envs.InputError(f"--{name.replace('_', '-')} is chosen by this program, run by run.")
    module: Any = script(algorithm)
    words = script_flags(task, sharing, flags)
    try:
        args = parse_flags(module.Args, module.paper_defaults, words, module.__doc__)
    except SystemExit:  # the script has said on stderr what is wrong
        raise envs.InputError(
            f"{algorithm} on {task} does not take the flags {' '.join(flags)}; algos/{algorithm}.py --help lists them"
        ) from None
    except envs.InputError as error:
        raise envs.InputError(f"{algorithm} on {task}: {error}") from None
    if args.eval_points < 2:
        raise envs.InputError("--eval-points must be 2 or more: the first evaluation comes before training.")
    paper = module.paper_defaults(task, sharing)
    changed = json.loads(json.dumps(changed_flags(args, paper)))  # as config.json has them: a tuple becomes a list
    setting = {
        "algorithm": algorithm,
        "task": task,
        "sharing": sharing,
        "flags": flags,
        "changed": changed,
        "total_timesteps": args.total_timesteps,
    }
    return setting, table_path(runs, algorithm, task, sharing, changed)


def script(algorithm: str) -> Any:
    """algos/<algorithm>.py as a module, loaded once."""
    if algorithm not in SCRIPTS:
        SCRIPTS[algorithm] = training.load_script(algorithm)
    return SCRIPTS[algorithm]


SCRIPTS: dict[str, Any] = {}


# --- what is there of a run ---
class Damaged(Exception):
    """A run directory that neither can be gone on with nor is complete; the message says why."""


def condition(run: Run) -> str:
    """What is there of a run: "new" (nothing to go on with), "begun", "complete". Raises Damaged.

    A script that goes on makes config.json and evaluations.csv again from its checkpoint, so these two may be damaged.
    """
    checkpoints = list(run.directory.glob("checkpoint*.pt"))
    if not any(is_whole(path) for path in checkpoints):
        if not checkpoints and is_complete(run):  # a copy without them
            return "complete"
        cut_off = [path.name for path in checkpoints] == ["checkpoint.new.pt"]  # the very first, while it was written
        if (checkpoints and not cut_off) or (run.directory / "evaluations.csv").exists():
            raise Damaged("it has no checkpoint that can be read")
        return "new"
    return "complete" if is_complete(run) else "begun"


def check_same_flags(run: Run) -> None:
    """ValueError where the directory holds a run with other flags, such as a shorter one that was made by hand.

    Where config.json cannot be read, nothing is known yet: the script makes it again.
    """
    try:
        config = json.loads((run.directory / "config.json").read_text())
        there = config["changed"] | {"seed": config["flags"]["seed"]}
    except (OSError, ValueError, KeyError, TypeError):
        return
    wanted = run.changed | {"seed": run.seed}
    different = sorted(name for name in there.keys() | wanted.keys() if there.get(name) != wanted.get(name))
    if different:
        raise ValueError(
            f"{run.directory} holds a run with another {', '.join(different)}: move it away, or keep the campaign's "
            "runs elsewhere with --runs"
        )


def drop_damaged_checkpoints(run: Run) -> list[str]:
    """Removes checkpoints whose check sums are wrong, so that the script takes the one before; gives their names.

    Loading them would not always tell: PyTorch does not look at the check sums.
    """
    damaged = [path for path in run.directory.glob("checkpoint*.pt") if not is_whole(path)]
    for path in damaged:
        path.unlink()
    return [path.name for path in damaged]


def is_complete(run: Run) -> bool:
    """Whether a run has all its evaluations, in order, and the settings that it was made with."""
    try:
        config = json.loads((run.directory / "config.json").read_text())
        rows = read_evaluations(run.directory)
        points = [int(row["point"]) for row in rows]
        budget, last = config["flags"]["total_timesteps"], int(rows[-1]["timestep"])
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return False
    return points == list(range(len(points))) and last >= budget >= run.total_timesteps


def read_evaluations(directory: Path) -> list[dict[str, str]]:
    """The rows of evaluations.csv."""
    with open(directory / "evaluations.csv", newline="") as file:
        return list(csv.DictReader(file))


def set_aside(run: Run, runs: Path) -> Path:
    """Moves a run's directory out of the runs folder, to one beside it; gives the new place."""
    folder = runs.with_name(f"{runs.name}-damaged") / run.directory.relative_to(runs)
    places = itertools.chain([folder], (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2)))
    target = next(place for place in places if not place.exists())
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(run.directory, target)
    return target


def log_path(run: Run) -> Path:
    """Where the output of a run goes: beside its directory, which belongs to the script."""
    return run.directory.with_name(f"log-{run.directory.name}.txt")


def command(run: Run, directory: Path, algos: Path) -> list[str]:
    """The command that begins a run in this directory, or goes on with what is there."""
    script_file = str(algos / f"{run.algorithm}.py")
    return [sys.executable, script_file, *run.arguments(), "--run-dir", str(directory), "--resume"]
