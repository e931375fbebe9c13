"""What a campaign is to run: scripts, tasks, the grids of flags, and the runs that they make together."""

import csv
import functools
import importlib.util
import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import envs
from benchmark import hyperparameters, store
from envs.runs import changed_flags, parse_flags, run_path
from envs.runs.flags import as_flag

ALGOS = Path(__file__).resolve().parents[1] / "algos"
Flags = tuple[str, ...]
Grid = list[dict[str, str]]  # the lines of a grid, by GRID_COLUMNS
GRID_COLUMNS = ["algorithms", "families", "flag", "values"]
Seeds = dict[tuple[str, str], int]  # how many seeds each row of the tables gets: by task and sharing
SEEDS_COLUMNS = ["task", "sharing", "seeds"]
OF_THIS_PROGRAM = ["env", "parameter_sharing", "seed", "run_dir", "resume", "watch"]  # flags that it gives itself


def script_names() -> list[str]:
    """The algorithms: what lies in algos/ and has flags, but no modules that only help such scripts."""
    paths = sorted(path for path in ALGOS.glob("*.py") if not path.name.startswith("."))  # an editor's lock file
    return [path.stem for path in paths if "\nclass Args" in path.read_text(encoding="utf-8")]


def chosen_scripts(words: list[str]) -> list[Path]:
    """The scripts that are named: an algorithm of algos/, the path of another script, or "all" of algos/.

    InputError for a word that is none of these, and for another script with the name of one of algos/.
    """
    names = script_names()
    paths: list[Path] = []
    for word in words:
        path = Path(word).resolve()
        if word in ("all", *names):
            paths += [ALGOS / f"{name}.py" for name in names if word in ("all", name)]
        elif path.suffix != ".py" or not path.is_file():
            raise envs.InputError(f"--algorithms {word}: neither one of {', '.join(names)}, all, nor a script's path.")
        elif path.stem in names and path.parent != ALGOS:
            raise envs.InputError(f"--algorithms {word}: algos/ has a {path.name}, so the script needs another name.")
        else:
            paths.append(path)
    paths = list(dict.fromkeys(paths))
    if len({path.stem for path in paths}) < len(paths):
        raise envs.InputError("--algorithms: two scripts have the same name, and results go by the name.")
    return paths


def load_script(path: Path) -> ModuleType:
    """A script as a module, made anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where its flags and their help are looked for
    spec.loader.exec_module(module)
    return module


script = functools.cache(load_script)  # the same module each time


@dataclass(frozen=True)
class PlannedRun(store.BenchmarkRun):
    """One run of a script. flags: for the script, beyond task, seed and sharing."""

    flags: Flags
    total_timesteps: int

    def __str__(self) -> str:
        return f"{self.directory.parent.parent.name} {self.directory.parent.name} seed {self.seed}"

    def arguments(self) -> list[str]:
        """The script's command line, without its directory."""
        return ["--seed", str(self.seed), *script_flags(self.task, self.sharing, self.flags)]

    def command(self) -> list[str]:
        """The command that begins the run in its directory, or goes on with what is there."""
        return [sys.executable, str(self.script), *self.arguments(), "--run-dir", str(self.directory), "--resume"]

    @property
    def log(self) -> Path:
        """Where its output goes: beside its directory, which belongs to the script."""
        return self.directory.with_name(f"log-{self.directory.name}.txt")


def script_flags(task: str, sharing: str, flags: Flags) -> list[str]:
    """The flags that decide what a script trains, but for the seed."""
    return ["--env", task, as_flag("parameter_sharing", sharing == "shared"), *flags]


def chosen_tasks(words: list[str]) -> list[str]:
    """Tasks by name, by family, or "all" of the paper's. InputError for a word that is none of these."""
    by_family: dict[str, list[str]] = {"all": envs.task_names()}
    for name in envs.task_names():
        by_family.setdefault(envs.task(name).family, []).append(name)
    tasks: list[str] = []
    for word in words:
        tasks += by_family.get(word) or [envs.task(word).name]
    return list(dict.fromkeys(tasks))


def read_rows(path: Path, kind: str, columns: list[str]) -> list[dict[str, str]]:
    """The lines of a CSV with exactly these columns. InputError where it cannot be read or is no such file."""
    try:
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise envs.InputError(f"{path} cannot be read: {error}") from None
    if not rows or any(list(row) != columns or None in row.values() for row in rows):
        raise envs.InputError(f"{path} is not a {kind}: its columns must be {', '.join(columns)}.")
    return rows


def read_seeds(path: Path) -> Seeds:
    """A plan of seeds, such as benchmark/seeds.csv: columns task, sharing (shared or independent), seeds.

    InputError where the file cannot be read or is not of this form, and for a task that does not exist.
    """
    rows = read_rows(path, "plan of seeds", SEEDS_COLUMNS)
    wrong = [row for row in rows if row["sharing"] not in store.SHARING.values() or not row["seeds"].isdecimal()]
    if wrong or len({(row["task"], row["sharing"]) for row in rows}) < len(rows):
        raise envs.InputError(
            f"{path} is not a plan of seeds: each task and sharing (shared or independent) has one line and a number."
        )
    return {(envs.task(row["task"]).name, row["sharing"]): int(row["seeds"]) for row in rows}


def read_grid(path: Path) -> Grid:
    """A grid: columns algorithms, families, flag, values; several words in a cell are separated by spaces.

    Every combination of the values of those lines that name an algorithm and the task's family is one variant.
    InputError where the file cannot be read or is not of this form.
    """
    rows = read_rows(path, "grid", GRID_COLUMNS)
    if empty := [row["flag"] for row in rows if not row["flag"].strip() or not row["values"].split()]:
        raise envs.InputError(f"{path} has a line without a flag or without values: {', '.join(empty)}.")
    return rows


def variants(grid: Grid, algorithm: str, family: str) -> Iterator[Flags]:
    """Every combination of values that the grid has for an algorithm on tasks of a family, as flags for the script."""
    choices: dict[str, list[str]] = {}
    for line in grid:
        if algorithm in line["algorithms"].split() and family in line["families"].split():
            if (flag := line["flag"].strip().replace("-", "_")) in choices:
                raise envs.InputError(f"the grid has two lines of {flag} for {algorithm} on tasks of {family}.")
            choices[flag] = line["values"].split()
    for values in itertools.product(*choices.values()):
        flags = (
            as_flag(flag, {"true": True, "false": False}.get(value, value)) for flag, value in zip(choices, values)
        )
        yield tuple(word for flag in flags for word in flag.split())


def make_plan(scripts: list[Path], seeds: Seeds, flags: Flags, grid: Grid | None, runs: Path) -> list[PlannedRun]:
    """The runs of a campaign, all of the first seed first. InputError where a script refuses the flags."""
    settings = []
    by_task: dict[str, list[str]] = {}
    for task, sharing in seeds:
        by_task.setdefault(task, []).append(sharing)
    rows = ((task, path, sharing) for task in by_task for path in scripts for sharing in by_task[task])
    for task, path, sharing in rows:
        family = envs.task(task).family
        chosen = [()] if grid is None else list(variants(grid, path.stem, family))
        if chosen == [()] and grid is not None:
            raise envs.InputError(f"the grid has no line for {path.stem} on tasks of the family {family}.")
        settings += [make_setting(path, task, sharing, (*variant, *flags)) for variant in chosen]
    plan = []
    for seed, setting in itertools.product(range(max(seeds.values())), settings):
        if seed >= seeds[setting["task"], setting["sharing"]]:
            continue
        name = setting["algorithm"], setting["task"], setting["sharing"] == "shared"
        plan.append(PlannedRun(**setting, seed=seed, directory=run_path(runs, *name, seed, setting["changed"])))
    if len({run.directory for run in plan}) < len(plan):
        raise envs.InputError(
            "variants of a grid must differ in more than total_timesteps, eval_points, eval_episodes."
        )
    return plan


def make_setting(path: Path, task: str, sharing: str, flags: Flags) -> dict[str, Any]:
    """What all seeds of a setting have in common. InputError as `hyperparameters.check` raises it, too."""
    algorithm = path.stem
    for word in flags:
        name = word.partition("=")[0].removeprefix("--").replace("-", "_").removeprefix("no_")
        if word.startswith("--") and name in OF_THIS_PROGRAM:
            raise envs.InputError(f"--{name.replace('_', '-')} is chosen by this program, run by run.")
    module: Any = script(path)
    paper = args = module.paper_defaults(task, sharing == "shared")
    try:
        if flags:  # reading a command line takes a while
            words = script_flags(task, sharing, flags)
            args = parse_flags(module.Args, module.paper_defaults, words, module.__doc__)
    except SystemExit:  # the script has said on stderr what is wrong
        raise envs.InputError(
            f"{algorithm} on {task} does not take the flags {' '.join(flags)}; {path.name} --help lists them"
        ) from None
    except envs.InputError as error:
        raise envs.InputError(f"{algorithm} on {task}: {error}") from None
    if args.eval_points < 2:
        raise envs.InputError("--eval-points must be 2 or more: the first evaluation comes before training.")
    changed = json.loads(json.dumps(changed_flags(args, paper)))  # as config.json has them: a tuple becomes a list
    hyperparameters.check(algorithm, vars(args), changed)
    return {
        "algorithm": algorithm,
        "task": task,
        "sharing": sharing,
        "flags": flags,
        "changed": changed,
        "total_timesteps": args.total_timesteps,
        "script": path,
    }
