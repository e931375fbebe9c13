"""The flags of a script: those that all share, reading and checking them, the environment that they name."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import itertools
import math
import os
import re
import shutil
import sys
import textwrap
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import psutil
import tyro

import envs
from envs.runs.terminal import flush_stdout
from envs.runs.valid import read_json
from envs.vector import RESULT_COLUMNS, InputError


@dataclass(kw_only=True)
class Flags:
    """The flags that all scripts share, and that do not say what is learnt, or how. The scripts' Args inherit them.

    A field without a value gets one for the task, from `filled`.
    """

    # evaluation
    eval_points: int  # from the task: evaluations at equal distances, the first before training
    eval_episodes: int = 100  # episodes of an evaluation, or of --watch
    # run
    device: Literal["cpu", "cuda"] = "cpu"  # where the networks live
    threads: int = 1  # CPU threads of PyTorch
    run_dir: str = ""  # where the run is kept; empty: runs/<task>/<algorithm>-.../seed<seed>
    resume: bool = False  # go on from the last checkpoint, if there is one
    start_from: str = ""  # take the first weights from the run or team in this directory
    track: bool = False  # follow the run in Weights & Biases
    # instead of a run
    watch: str = ""  # play and film the team of this run directory instead of training
    greedy: bool = False  # with --watch: always the best action
    # foreign environments
    env_kwargs: str = ""  # of a pettingzoo:, gymnasium: or own: environment, such as "N=2, k=0.5"
    max_episode_steps: int = 0  # cut episodes of a PettingZoo or Gymnasium environment here (0: do not)
    flatten_images: bool = False  # make vectors of the images of a PettingZoo or Gymnasium environment
    divide_images: bool = True  # divide images of bytes by 255; not where they have codes
    action_bins: int = 0  # values in each dimension of a continuous action, which is made discrete (0: it is refused)
    env_workers: int = 0  # processes that play a PettingZoo or Gymnasium environment (0: this one)


Args = TypeVar("Args")  # of a script

OF_THE_TASK = {"env_kwargs", "max_episode_steps", "flatten_images", "divide_images", "action_bins"}
# These say nothing of the setting
OF_ONE_RUN = {"seed", "env_workers", "device", "threads", "run_dir", "resume", "watch", "greedy", "track"}
WITH_WATCH = OF_THE_TASK | {"env", "env_workers", "seed", "eval_episodes", "threads", "watch", "greedy"}
MAY_CHANGE = OF_ONE_RUN - {"seed"} | {"total_timesteps"}  # when a run is resumed
NOT_IN_DIRECTORY = {"total_timesteps", "eval_points", "eval_episodes"}  # how long a run is, and when it is looked at


class Range(NamedTuple):
    """The values that a flag may have. Without `ends`, the two bounds themselves are not allowed."""

    lowest: float
    highest: float
    ends: bool = True


PROBABILITY = Range(0, 1)
SIZE = Range(1, 100_000)
COUNT = Range(1, 10**15)
WEIGHT = Range(0, 10**18)
RANGES = {  # of the flags of our scripts
    "seed": Range(0, 2**63 - 1),
    "total_timesteps": COUNT,
    "max_episode_steps": Range(0, 10**9),
    "action_bins": Range(0, 1024),
    "env_workers": Range(0, 10_000),
    "hidden_dim": Range(1, 16_384),
    "learning_rate": WEIGHT,
    "gamma": PROBABILITY,
    "n_step": COUNT,
    "entropy_coef": WEIGHT,
    "update_epochs": SIZE,
    "clip_coef": Range(0, 1, ends=False),
    "actor_regularisation": WEIGHT,
    "epsilon_start": PROBABILITY,
    "epsilon_end": PROBABILITY,
    "epsilon_anneal": Range(0, 10**15),
    "eval_epsilon": PROBABILITY,
    "batch_size": SIZE,
    "buffer_size": COUNT,
    "max_grad_norm": Range(0, math.inf),  # inf: gradients are not clipped
    "num_envs": SIZE,
    "eval_points": Range(1, 10**6),
    "eval_episodes": SIZE,
    "threads": Range(1, 256),
}


WHOLE_NUMBERS = tyro.constructors.ConstructorRegistry()


@WHOLE_NUMBERS.primitive_rule
def whole_numbers(info: Any) -> Any:
    """How tyro reads a flag of the type int: also as 1e6."""
    if info.type is not int:
        return None
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda words: whole_number(words[0]),
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    )


def whole_number(text: str) -> int:
    """Raises ValueError for what is none."""
    try:
        return int(text)
    except ValueError:
        pass
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value.is_integer():
        raise ValueError(f"{text} is not a whole number")
    return int(value)


def parse_flags(args_class: type[Args], defaults: Callable[..., Args], argv: list[str], doc: str | None) -> Args:
    """Reads the command line into a script's Args.

    defaults: makes the Args for a task and a kind of sharing. So these two flags are found first, in every spelling
    that tyro accepts. doc: the script's docstring, which heads its help.
    Raises InputError for what is no flag or no value of one, for a number out of range, for a device that is not there,
    and for flags that do not go together.
    """
    others = [word for word in argv if word not in ("-h", "--help")]
    with in_one_sentence():
        default, _ = tyro.cli(defaults, args=others, return_unknown_args=True)
    if len(others) < len(argv):
        with contextlib.suppress(BrokenPipeError, SystemExit):  # tyro exits where it has shown the flags
            show_help(args_class, default, doc or "")
        flush_stdout()
        sys.exit()
    with in_one_sentence():
        args: Any = tyro.cli(args_class, args=argv, default=default, registry=WHOLE_NUMBERS)
    check_flags(args)
    for name in ("watch", "start_from", "run_dir"):  # an unset variable of a shell, for example
        if name in given_flags(args_class, argv) and not getattr(args, name):
            raise InputError(f"--{name.replace('_', '-')} needs the directory of a run.")
    if args.watch and (others := sorted(given_flags(args_class, argv) - WITH_WATCH)):
        raise InputError(f"--watch plays what was trained; --{others[0].replace('_', '-')} is for a training.")
    if args.greedy and not args.watch:
        raise InputError("--greedy is for --watch; a training plays as its algorithm says.")
    if args.device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise InputError("--device cuda: PyTorch finds no CUDA device here.")
    return args


def filled(
    args_class: type[Args],
    env: str,
    parameter_sharing: bool,
    table: Mapping[tuple[str, str], tuple[Any, ...]],
    columns: str,
    budget: str,
) -> Args:
    """A script's Args for a task. A value that is written in Args counts; the others come from the table and the task.

    table: a row of hyperparameters for each family and kind of sharing, "other" for all families that have none;
    columns: their names. budget: the field of the task that is total_timesteps. Raises InputError where a field has no
    value in either.
    """
    task = envs.task(env)
    sharing = "shared" if parameter_sharing else "independent"
    row = table.get((task.family, sharing)) or table.get(("other", sharing), ())
    given = dict(zip(columns.split(), row))
    given |= {"total_timesteps": getattr(task, budget), "eval_points": task.eval_points}
    chosen = {name: given[name] for name in without_value(args_class) if name in given}
    if missing := [name for name in without_value(args_class) if name not in chosen]:
        raise InputError(f"{missing[0]} has no value in Args, and no row of PAPER gives one for {env}, {sharing}.")
    return args_class(**{"env": env, "parameter_sharing": parameter_sharing, **chosen})


def without_value(args_class: type) -> list[str]:
    """The fields of a script's Args whose values come from its table or from the task."""
    return [field.name for field in dataclasses.fields(args_class) if field.default is dataclasses.MISSING]


@contextlib.contextmanager
def in_one_sentence() -> Iterator[None]:
    """What tyro says of a wrong command line, a box of several lines, becomes InputError with its sentence."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            yield
    except SystemExit:
        lines = [line.strip("│|╭╮╰╯─- ") for line in said.getvalue().split("\n")]
        sentence = " ".join(itertools.takewhile(bool, itertools.dropwhile(lambda line: not line, lines[2:])))
        near = re.search(r"Perhaps you meant\W+(--[\w-]+)", said.getvalue())
        more = f"did you mean {near[1]}?" if near else "--help lists the flags."
        raise InputError(f"{sentence.rstrip('.')}; {more}") from None


def given_flags(args_class: type, argv: list[str]) -> set[str]:
    """The names of the flags that a command line has, whatever their values."""
    fields = {field.name for field in dataclasses.fields(args_class)}
    words = {word[2:].partition("=")[0].replace("-", "_") for word in argv if word.startswith("--")}
    return (words | {word.removeprefix("no_") for word in words}) & fields


def as_flag(name: str, value: Any) -> str:
    """A flag and its value as they are written on the command line."""
    flag = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{flag}" if value else f"--no-{flag}"
    return f"--{flag} {value}"


def check_flags(args: Any) -> None:
    """Raises InputError for the first flag of a script's Args whose number is out of range.

    A new flag of a script has its Range in its annotation: `gae_lambda: Annotated[float, runs.Range(0, 1)] = 0.95`.
    """
    hints = typing.get_type_hints(type(args), include_extras=True)
    for name, value in vars(args).items():
        annotated = [part for part in getattr(hints.get(name), "__metadata__", ()) if isinstance(part, Range)]
        allowed = annotated[0] if annotated else RANGES.get(name)
        if allowed is None:
            continue
        inside = allowed.lowest <= value <= allowed.highest
        if not inside or (not allowed.ends and value in allowed[:2]):
            low, high = allowed.lowest, allowed.highest
            bounds = f"between {low:,} and {high:,}" if allowed.ends else f"above {low:,} and below {high:,}"
            raise InputError(f"{as_flag(name, value)}: the value must lie {bounds}.")


def named_flags(args: Any) -> dict[str, Any]:
    """A script's flags as results name them: what a file or a run holds counts, and not where it lies on a machine.

    Raises InputError where --start-from names no run.
    """
    named = vars(args) | {"env_kwargs": envs.named_kwargs(args.env, args.env_kwargs)}
    if named.get("start_from"):
        named["start_from"] = identity(named["start_from"])
    return named


def changed_flags(args: Any, default: Any) -> dict[str, Any]:
    """The flags of a setting that differ from the default. Task, sharing and seed are named elsewhere.

    What is played stands first, then how, so that the names of directories do not depend on the order in Args.
    """
    named = OF_ONE_RUN | {"env", "parameter_sharing"}
    ordered = sorted(named_flags(args).items(), key=lambda flag: flag[0] not in OF_THE_TASK)
    return {name: value for name, value in ordered if name not in named and value != getattr(default, name)}


def identity(directory: str | os.PathLike[str]) -> str:
    """What run or team a directory holds: task, algorithm, sharing, seed and the hash of the script's text."""
    try:
        config = read_json(Path(directory, "config.json"))
        flags = config["flags"]
        sharing = "shared" if flags["parameter_sharing"] else "independent"
        return f"{flags['env']} {config['algorithm']}-{sharing} seed {flags['seed']} script {config.get('script')}"
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"--start-from: {directory} holds no run.") from error


def show_help(args_class: type, default: Any, doc: str) -> None:
    """Prints a script's docstring, wrapped to the terminal, and tyro's list of the flags.

    tyro itself would make one long line of each paragraph, and begin with the flags of all scripts.
    """
    fields = args_class.__dataclass_fields__  # type: ignore[attr-defined]
    for field in dataclasses.fields(Flags):  # go behind the script's own
        fields[field.name] = fields.pop(field.name)
    width = min(shutil.get_terminal_size().columns, 120) - 1
    for paragraph in [*doc.strip().split("\n\n"), origin_of_values(args_class, default)]:
        if not paragraph.startswith("    "):  # formulas and commands keep their lines
            paragraph = textwrap.fill(" ".join(paragraph.split()), width, break_on_hyphens=False)
        print(paragraph, end="\n\n")
    tyro.cli(args_class, args=["--help"], default=default, description="")


def origin_of_values(args_class: type, default: Any) -> str:
    """Says where the values that the help shows come from."""
    of_paper = [name for name in without_value(args_class) if name not in ("total_timesteps", "eval_points")]
    of_task = [name for name in without_value(args_class) if name not in of_paper]
    parts = [
        f"{source} gives {', '.join('--' + name.replace('_', '-') for name in names)}"
        for source, names in (("PAPER", of_paper), ("the task", of_task))
        if names
    ]
    sharing = "with" if default.parameter_sharing else "without"
    return f"Values for {default.env}, {sharing} parameter sharing: {'; '.join([*parts, 'Args gives all others'])}."


def make_for(args: Any, num_envs: int, seed: int = 0, pictures: bool = False) -> envs.VectorEnv:
    """The environment that a script's flags name, with copy=False.

    Raises InputError as `envs.make` does, and for a statistic that evaluations.csv could not show.
    """
    env = envs.make(
        args.env,
        num_envs,
        seed,
        copy=False,
        env_kwargs=args.env_kwargs,
        max_episode_steps=args.max_episode_steps,
        flatten_images=args.flatten_images,
        divide_images=args.divide_images,
        action_bins=args.action_bins,
        env_workers=args.env_workers,
        pictures=pictures,
    )
    if taken := sorted(RESULT_COLUMNS & set(env.statistics)):
        raise InputError(
            f"{env.name}: no statistic can have the name {taken[0]!r}, which results of runs have already."
        )
    return env


def check_room(env: envs.VectorEnv) -> None:
    """Raises InputError where an episode of each sub-environment, which a script stores, does not fit into memory."""
    numbers = env.n_agents * env.obs_size + (0 if env.state_is_observations else env.state_size)
    step = 4 * numbers + env.n_agents * (env.n_actions + 12)  # bytes; 12 for an action and a reward
    room, free = (env.episode_limit + 1) * env.num_envs * step, psutil.virtual_memory().available
    if room > free:
        raise InputError(
            f"{env.name}: episodes of {env.episode_limit:,} steps in {env.num_envs:,} sub-environments take "
            f"{room / 2**20:,.0f} MiB, more than the free memory ({free / 2**20:,.0f}); `max_episode_steps` makes "
            "episodes of environments that are not ours shorter."
        )


def check_teams(env: envs.VectorEnv, individual_rewards: bool, parameter_sharing: bool) -> None:
    """Raises InputError where opposing teams would learn from one reward, or with one network, and as `check_room`."""
    check_room(env)
    if len(set(env.teams)) > 1 and not (individual_rewards and not parameter_sharing):
        raise InputError(f"{env.name} has opposing teams, which need --individual-rewards and --no-parameter-sharing.")


def check_one_team(env: envs.VectorEnv, reason: str) -> None:
    """Raises InputError where an algorithm that learns from the team's reward would train opposing teams.

    And as `check_room`.
    """
    check_room(env)
    if len(set(env.teams)) > 1:
        raise InputError(f"{env.name} has opposing teams: {reason}.")
