"""What happens around a training, the same in all scripts: evaluation, checkpoint, resume, log, signals, watching."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

import envs
from envs.faults import is_ours, place
from envs.runs.checkpoints import check_distance
from envs.runs.directory import RunDirectory, fitting_checkpoint, last_checkpoint, read_checkpoint, write_episodes
from envs.runs.flags import OF_THE_TASK, given_flags, make_for, parse_flags
from envs.runs.log import Log, in_words
from envs.runs.process import StopSignals, keep_freed_memory
from envs.runs.replay import EpisodeFile
from envs.runs.terminal import Diverged, one_sentence, show
from envs.tasks import OF_OTHERS
from envs.vector import EpisodeTotals, InputError, VectorEnv
from envs.workers import closed_games

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class Team(Protocol):
    """Agents at play, as the class of this name in each script."""

    args: Any

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forgets the last episode. To be called before each new one. mask, [env]: only there."""

    def act(self, observations: NDArray[np.float32], info: dict[str, Any]) -> NDArray[np.int64]:
        """observations: [env, agent, obs]. Returns the actions, [env, agent]."""


def play(env: VectorEnv, team: Team, seed: int) -> EpisodeTotals:
    """Plays one episode in each sub-environment, all drawn from the seed."""
    observations, info = env.reset(seed=seed)
    team.reset()
    totals = EpisodeTotals(env)
    while not totals.ended.all():
        actions = team.act(observations, info)
        observations, rewards, terminated, truncated, info = env.step(actions)
        totals.add(rewards, terminated, truncated, info)
    return totals


def evaluate(env: VectorEnv, team: Team, seed: int) -> dict[str, float]:
    """Plays one episode in each sub-environment, all drawn from the seed. Returns their means."""
    return play(env, team, seed).means()


class Run:
    """One run of a script: its evaluations, checkpoints and log. The script's loop says when each has its turn.

        run = Run(__file__, args, paper_defaults, env, parts, Team, rng)

    begins the run, or with --resume goes on from its last checkpoint. Then `timestep` says how many steps of single
    environments were played, and `n_updates` how many updates were made, which the script counts itself.

        run.evaluate_if_due()                       evaluates and saves at the evaluation points
        run.count(batch.played, returns, metrics)   counts the steps and shows how it goes; ends the process where a
                                                    loss is no finite number
        run.stop_if_asked()                         after Ctrl-C, SIGTERM or SIGHUP: saves, and ends the process
        run.save_if_due()                           saves where the last checkpoint is some minutes old
        run.complete()                              saves the end, and deletes what only a running run needs
        run.episode_file(fields, size)              the file of a replay, which is saved with the run
        run.add_part(name, part)                    one more part of the checkpoints, where making it needs the run

    Checkpoints are made between batches only, when no episode is under way.
    """

    def __init__(
        self,
        script: str | os.PathLike[str],
        args: Any,
        paper_defaults: Callable[[str, bool], Any],
        env: VectorEnv,
        parts: dict[str, Any],
        team_class: Callable[..., Team],
        rng: torch.Generator,
    ) -> None:
        """script: the file that runs. args: its flags; paper_defaults: makes those of the paper for a task.

        env: is trained in. parts: by name, what a checkpoint keeps; each has a state_dict, and "agents" is what plays.
        team_class: makes a team of the agents. rng: all that the training draws from.
        Raises InputError as RunDirectory does, and where a checkpoint, or that of --start-from, does not fit.
        """
        self.args, self.env, self.parts, self.team_class, self.rng = args, env, parts, team_class, rng
        self.timestep = self.n_updates = 0
        self.first_total = args.total_timesteps  # when the run was begun: a longer total does not move its points
        self.rows: list[dict[str, float]] = []  # of evaluations.csv
        self.replay: EpisodeFile | None = None
        self.saved_parts: dict[str, Any] | None = None  # of the checkpoint that the run went on from
        self.eval_env = make_for(args, args.eval_episodes)
        self.directory = RunDirectory(script, args, paper_defaults(args.env, args.parameter_sharing))
        saved = self.directory.checkpoint()
        if saved is not None:
            with fitting_checkpoint(self.directory.path):
                self.restore(saved)
        elif args.start_from:
            start_from(args.start_from, self.directory.config["algorithm"], parts)
        self.resumed = saved is not None
        self.source = self.directory.path if self.resumed else args.start_from  # of weights that no update has met yet
        self.signals = StopSignals()

    @functools.cached_property
    def log(self) -> Log:
        """What the run shows; it is made when all else is there, so that a run which is refused leaves nothing."""
        return Log(self.directory.path, self.args, self.timestep, self.resumed)

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Goes on where a checkpoint was made."""
        from envs.runs.weights import load_part  # imports PyTorch

        batch = self.env.num_envs * self.env.episode_limit
        of_run = (saved["timestep"], len(saved["rows"]), batch)
        check_distance(self.args.eval_points, saved["budget"], self.args.total_timesteps, *of_run)
        self.saved_parts = saved["parts"]
        for name, part in self.parts.items():
            load_part(part, self.saved_parts.pop(name))
        self.rng.set_state(saved["rng"])
        self.env.episode = saved["episode"]
        self.timestep, self.n_updates = saved["timestep"], saved["updates"]
        self.first_total, self.rows = saved["budget"], saved["rows"]

    def save(self) -> None:
        """Writes a checkpoint, and with it config.json and evaluations.csv."""
        if self.replay is not None:
            self.replay.flush()
        self.directory.save(
            rows=self.rows,
            network=(self.env.n_agents, self.env.obs_size, self.env.n_actions, self.args.network),
            parts={name: part.state_dict() for name, part in self.parts.items()},
            rng=self.rng.get_state(),
            episode=self.env.episode,  # beside the seed, all that the environments' randomness depends on
            timestep=self.timestep,
            updates=self.n_updates,
            budget=self.first_total,
        )

    def episode_file(self, fields: Mapping[str, NDArray[Any]], size: int) -> EpisodeFile:
        """The file of a replay of so many episodes; fields: an array for each field of an episode, time first."""
        self.replay = EpisodeFile(self.directory.path / "replay.bin", fields, size, self.env.episode)
        return self.replay

    def add_part(self, name: str, part: Any) -> None:
        """Keeps one more part in checkpoints, such as a replay's priorities, and restores it where the run goes on.

        part: has state_dict, which gives tensors and plain types, and load_state_dict.
        """
        self.parts[name] = part
        if self.saved_parts is not None:
            with fitting_checkpoint(self.directory.path):
                part.load_state_dict(self.saved_parts.pop(name))

    def point_is_due(self) -> bool:
        """Whether the steps have reached or passed the next evaluation point."""
        steps = min(self.timestep, self.args.total_timesteps)  # no point lies beyond the total
        # Point p is due at p * first_total / (eval_points - 1) steps; in integers nothing is rounded.
        return len(self.rows) * self.first_total <= steps * (self.args.eval_points - 1)

    def evaluate_if_due(self) -> None:
        """Evaluates and saves at the evaluation points, of which a batch may pass several.

        Each has a seed of its own, for its episodes and for what the team draws, so evaluations change nothing in the
        training.
        """
        import torch

        log = self.log
        while self.point_is_due():
            point = len(self.rows)
            seed = int(np.random.SeedSequence([self.args.seed, point]).generate_state(1)[0])
            team = self.team_class(self.args, self.parts["agents"], torch.Generator().manual_seed(seed))
            results = evaluate(self.eval_env, team, seed)
            seconds = self.directory.seconds()
            self.rows.append({"point": point, "timestep": self.timestep, **seconds, **results})
            log.evaluation(self.timestep, results)
            self.save()

    def count(self, played: Tensor, returns: NDArray[np.float64], metrics: Mapping[str, Tensor]) -> None:
        """Counts and logs a batch.

        played: [time, env], of its episodes; returns: theirs, [env]; metrics: what `update` returned.
        Raises as the log's `batch`, and InputError where weights that were read lead to no finite loss at once.
        """
        lengths = played.sum(0).tolist()
        self.timestep += sum(lengths)
        try:
            self.log.batch(self.timestep, returns.tolist(), lengths, metrics)
        except Diverged as error:
            if not self.source:
                raise
            raise InputError(f"The weights of {self.source} cannot be trained on: {error}") from error
        if metrics:
            self.source = ""

    def stop_if_asked(self) -> None:
        """Saves and ends the process where a signal has come, such as Ctrl-C."""
        self.signals.keep()
        if self.signals.received:
            self.save()
            self.log.close()
            self.close()
            self.signals.exit(self.timestep)

    def save_if_due(self) -> None:
        """Saves where the last checkpoint is old, and before a slot of the replay is used again that it refers to."""
        if self.directory.save_is_due or (self.replay and self.env.episode % self.replay.checkpoint_every == 0):
            self.save()

    def complete(self) -> None:
        """Saves the end of the training, and deletes what only a running run needs."""
        if self.rows[-1]["timestep"] < self.timestep:
            self.save()
        if self.replay is not None:
            self.replay.close()  # Windows deletes no file that is in use
        self.directory.complete()
        self.log.close()
        self.close()

    def close(self) -> None:
        """Closes the environments, which may hang: the signals end the process again."""
        self.signals.give_back()
        self.env.close()
        self.eval_env.close()


def own_generator() -> torch.Generator:
    """A generator that goes on where PyTorch's global one is, and that nobody else draws from or seeds."""
    import torch

    rng = torch.Generator()
    rng.set_state(torch.get_rng_state())
    return rng


def start_from(directory: str, algorithm: str, parts: Mapping[str, Any]) -> None:
    """Gives networks the weights that a run, or a team, of the same algorithm has. Targets begin as copies, as always.

    Raises InputError where there is no such run, and where shapes differ. A team has no networks but its agents.
    """
    from envs.runs.weights import load_part  # imports PyTorch

    saved = read_checkpoint(directory, algorithm)["parts"]
    for name, part in parts.items():
        source = name.removeprefix("target_")
        if source.endswith("optimiser") or source not in saved:
            continue
        with fitting_checkpoint(directory):
            ours, theirs = (
                {weights: tuple(x.shape) for weights, x in of.items()} for of in (part.state_dict(), saved[source])
            )
            for weights in ours | theirs:
                if ours.get(weights) != theirs.get(weights):
                    raise InputError(
                        f"--start-from: {source} of {directory} does not fit: the shape of {weights} is "
                        f"{theirs.get(weights, 'none')} there and {ours.get(weights, 'none')} here."
                    )
            load_part(part, saved[source])


def watch(args: Any, load: Callable[..., Team], given: set[str]) -> None:
    """Plays what was trained and prints the results, then films the first of the same episodes.

    given: the flags of the command line. Those of the task take the place of the run's own. Raises InputError where the
    networks do not fit the task, and where the run alone names code of others: whoever made it chose what that is.
    """
    team = load(args.watch, args.seed, args.greedy)
    own = team.args.env
    if "env" not in given and own.startswith(OF_OTHERS):
        raise InputError(
            f"The team of {args.watch} plays {own}, which is code of others; if you trust it, add --env "
            f"{shlex.quote(own)}."
        )
    another = "env" in given and args.env != own
    chosen = {"env", *OF_THE_TASK} if another else given & OF_THE_TASK  # another task has other arguments
    chosen |= {"env_workers"}  # how many processes begin here is not for a run of others to say
    played = dataclasses.replace(team.args, **{name: getattr(args, name) for name in chosen})
    env = make_for(played, args.eval_episodes, pictures=True)
    saved = last_checkpoint(args.watch) or {}
    n_agents, obs_size, n_actions = saved["network"][:3]
    if (n_agents, obs_size, n_actions) != (env.n_agents, env.obs_size, env.n_actions):
        raise InputError(
            f"The team of {args.watch} does not fit: it has {n_agents} agents with {obs_size} observations and "
            f"{n_actions} actions; {env.name} has {env.n_agents} with {env.obs_size} and {env.n_actions}."
        )
    totals = play(env, team, args.seed)
    show(in_words(totals.means()))
    team = load(args.watch, args.seed, args.greedy)  # one that has drawn nothing yet, so that it plays the same
    show(envs.film(env, team, args.seed, Path(args.watch, "film.gif")))
    env.close()
    try:
        show(f"episodes: {write_episodes(args.watch, totals)}")
    except OSError as error:  # a directory that cannot be written, a full disk
        show(f"There is no place for the episodes: {error}")


def main(
    script: str,
    doc: str | None,
    args_class: type[Any],
    paper_defaults: Callable[..., Any],
    train: Callable[[Any], None],
    load: Callable[..., Team],
) -> None:
    """A script's program: trains or plays, as the command line says.

    script, doc: its file and docstring; then its Args and functions. Wrong input ends with one sentence and exit code
    2.
    """
    is_the_program = script == getattr(sys.modules["__main__"], "__file__", None)  # and no test, or notebook, calls it
    with closed_games() if is_the_program else contextlib.nullcontext(), one_sentence(script):
        args = parse_flags(args_class, paper_defaults, sys.argv[1:], doc)
        import torch

        keep_freed_memory()
        torch.set_num_threads(args.threads)
        try:
            if args.watch:
                watch(args, load, given_flags(args_class, sys.argv[1:]))
            else:
                train(args)
        except SystemExit as end:  # of an environment in which nothing else looks for it
            if args.env.startswith("own:") and not is_ours(end):
                raise InputError(f"{args.env}: its code ends the program ({place(end)}).") from end
            raise
