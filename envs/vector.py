"""The contract of an environment: many copies of a task, stepped together, as a `gymnasium.vector.VectorEnv`.

    observations, info = env.reset(seed=None, options=None)
    observations, rewards, terminated, truncated, info = env.step(actions)

    actions                int     [num_envs, n_agents]
    observations           float32 [num_envs, n_agents, obs_size]    padded at the end to the largest agent
    rewards                float32 [num_envs]      the team's reward on the paper's scale
    terminated             bool    [num_envs]      a real end: the value after it is zero
    truncated              bool    [num_envs]      the clock ran out: the state after it still has a value
    info["agent_rewards"]  float32 [num_envs, n_agents]              each agent's own reward
    info["state"]          float32 [num_envs, state_size]            a view of the observations if it consists of them
    info["action_mask"]    bool    [num_envs, n_agents, n_actions]   always at least one action
    info["statistics"]     dict of float32 [num_envs]                what a family reports about an episode besides its
                                                                     return; valid where an episode has just ended. NaN:
                                                                     this episode has none
    env.teams              for each agent the number of its team; all 0 in cooperative tasks
    env.agent_names        for each agent its name, <kind>_<number>: agents of one kind have equal actions and one team
    env.choices            for each agent the number of its own actions; where they are fewer than n_actions, the mask
                           forbids the rest

Nothing resets by itself (Gymnasium's autoreset mode DISABLED). A finished sub-environment stands still, with reward 0
and its flag up, until a reset: of all sub-environments, or of those that options["reset_mask"] (bool [num_envs]) names.
Where teams oppose each other, the team's reward is that of team 0.

Gymnasium's `RecordEpisodeStatistics` counts an episode in every step in which a flag is up. In a loop that waits until
all sub-environments have finished, it counts those that stand still again and again: in a trial with random actions on
`lbf-5x5-2p-1f` it counted 273 episodes where there were eight. It counts right if the loop resets at once whatever has
finished:

    recording = RecordEpisodeStatistics(env)
    observations, info = recording.reset()
    for _ in range(steps):
        observations, rewards, terminated, truncated, info = recording.step(act(observations, info))
        finished = terminated | truncated
        if finished.any():
            observations, info = recording.reset(options={"reset_mask": finished})
"""

from __future__ import annotations

import functools
import importlib
import operator
import secrets
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, MultiDiscrete
from gymnasium.vector import AutoresetMode
from gymnasium.vector import VectorEnv as GymnasiumVectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

Info = dict[str, Any]
RESULTS = ("observations", "rewards", "terminated", "truncated")
INFO_ARRAYS = ("agent_rewards", "state", "action_mask")  # of the info, besides the statistics
NUMBERS = {  # arrays of numbers, and what one of them is
    "observations": "an observation",
    "rewards": "a reward",
    "agent_rewards": "an agent's reward",
    "state": "a state",
}


# Columns of evaluations.csv and of benchmark/results, whose names no statistic can have
RESULT_COLUMNS = {"point", "timestep", "wall_seconds", "cpu_seconds", "return_mean", "return_std", "episode_length"}
RESULT_COLUMNS |= {"task", "family", "algorithm", "sharing", "setting", "seed", "total_timesteps", "paper_timesteps"}
RESULT_COLUMNS |= {"commit", "episode", "return"}


class InputError(ValueError):
    """The user asked for something that cannot be done, such as an unknown task. The message is one sentence.

    It names an option as `max_episode_steps`; a script shows that as the flag --max-episode-steps.
    """


class WorkerLost(InputError):
    """A worker process was killed, which is no mistake of the user's: a run can go on from its last checkpoint."""


def fresh_seed() -> int:
    """A seed that nobody has chosen, from the system's randomness."""
    return secrets.randbits(63)


def episode_generator(seed: int, index: int, episode: int) -> np.random.Generator:
    """The random generator of an episode of sub-environment `index`, for rules that are not compiled."""
    # A spawn key, since NumPy fills up with zeros: default_rng([seed, 0, 0]) is the default_rng(seed) of other code
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, episode)))


def episode_seed(seed: int, index: int, episode: int) -> int:
    """What an episode of sub-environment `index` is seeded with where its generator is not ours: 0 .. 2^31 - 1."""
    return int(np.random.SeedSequence([seed, index, episode]).generate_state(1)[0] >> 1)


def kinds_of(teams: Sequence[int], choices: Sequence[int]) -> list[str]:
    """A word for each agent: its team, where there are several, and its number of actions, where these differ."""
    kinds = [f"team{team}" if len(set(teams)) > 1 else "agent" for team in teams]
    several = {kind for kind in kinds if len({n for k, n in zip(kinds, choices) if k == kind}) > 1}
    return [f"{kind}_with_{n}_actions" if kind in several else kind for kind, n in zip(kinds, choices)]


def numbered(kinds: Sequence[str]) -> tuple[str, ...]:
    """Names that tell equal kinds apart: speaker_0, listener_0, listener_1."""
    seen: Counter[str] = Counter()
    names = []
    for kind in kinds:
        names.append(f"{kind}_{seen[kind]}")
        seen[kind] += 1
    return tuple(names)


def forbidden_action(actions: NDArray[np.int64], action_mask: NDArray[np.bool_]) -> int:
    """Index (sub-environment times agents plus agent) of the first action that may not be taken, or -1.

    actions: [env, agent]; action_mask: [env, agent, action]. `envs.families.kernels` has the same for compiled rules.
    """
    exists = (actions >= 0) & (actions < action_mask.shape[2])
    chosen = np.where(exists, actions, 0)[:, :, None]
    allowed = exists & np.take_along_axis(action_mask, chosen, axis=2)[:, :, 0]
    return -1 if allowed.all() else int(allowed.argmin())


def check_number(num_envs: int) -> None:
    """Raises ValueError where there is no sub-environment, or more than any memory has room for."""
    if num_envs < 1:
        raise ValueError(f"num_envs is {num_envs}; there must be at least one sub-environment.")
    if num_envs > 2**60:  # more than NumPy can count the bytes of
        raise ValueError(f"num_envs is {num_envs}; there must be at most 2^60 sub-environments.")


def check_seed(seed: int) -> None:
    """Raises ValueError for a seed out of range."""
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed is {seed}; it must lie between 0 and 2^64 - 1.")


class VectorEnv(GymnasiumVectorEnv):
    """What all families share. A family fills the arrays, in one of two ways.

    Game by game, in plain Python: it overrides `reset_env` and `step_env`. All at once, by compiled rules for example:
    it overrides `reset_envs` and `step_envs`.

    name, num_envs, n_agents, n_actions, obs_size, state_size, episode_limit: the task and its sizes.
    seed: the seed in use. episode: the number of episodes begun so far, which is all that a checkpoint must keep.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 (typed like this by Gymnasium)
    can_draw = False
    picture = ""  # the module of `envs.pictures` that draws this family
    checks_numbers = False  # whether what is not a finite number is an error; so for all environments but our own

    def __init__(
        self,
        name: str,
        num_envs: int,
        seed: int,
        copy: bool,
        *,
        n_agents: int,
        n_actions: int,
        obs_size: int,
        episode_limit: int,
        low: float,
        high: float,
        state_size: int | None = None,
        statistics: Sequence[str] = (),
        teams: Sequence[int] | None = None,
        choices: Sequence[int] | None = None,
        kinds: Sequence[str] | None = None,
    ) -> None:
        """low, high: the bounds of an observation's values. state_size: None if the state consists of the observations.

        statistics: the names of the entries of `self.statistics`. teams: None if all agents belong to one team.
        choices: None if each agent has n_actions actions. kinds: for each agent the word that its name begins with;
        None for `agent`, and more where there are several teams or agents with other numbers of actions.
        """
        check_number(num_envs)
        if choices is not None and (len(choices) != n_agents or not 1 <= min(choices) <= max(choices) <= n_actions):
            raise ValueError(f"choices is {choices}; it must have a number from 1 to {n_actions} for each agent.")
        self.name, self.num_envs, self.copy = name, num_envs, copy
        self.n_agents, self.n_actions, self.obs_size = n_agents, n_actions, obs_size
        self.state_size = n_agents * obs_size if state_size is None else state_size
        self.episode_limit = episode_limit

        self.single_observation_space = Box(low, high, (n_agents, obs_size), np.float32)
        self.choices = tuple(choices) if choices is not None else (n_actions,) * n_agents
        self.single_action_space = MultiDiscrete(np.array(self.choices))

        self.observations = np.zeros((num_envs, n_agents, obs_size), np.float32)
        self.rewards = np.zeros(num_envs, np.float32)
        self.terminated = np.zeros(num_envs, np.bool_)
        self.truncated = np.zeros(num_envs, np.bool_)
        self.agent_rewards = np.zeros((num_envs, n_agents), np.float32)
        self.action_mask = np.ones((num_envs, n_agents, n_actions), np.bool_)
        self.action_mask[:] = np.arange(n_actions) < np.array(self.choices)[:, None]
        self.statistics = {name: np.zeros(num_envs, np.float32) for name in statistics}
        self.teams = tuple(teams) if teams is not None else (0,) * n_agents
        self.agent_names = numbered(kinds or kinds_of(self.teams, self.choices))
        self.state_is_observations = state_size is None
        if state_size is not None:
            self.state = np.zeros((num_envs, state_size), np.float32)
        self._connect()
        self._episodes = np.zeros(num_envs, np.int64)  # episodes begun, per sub-environment
        self._shape = (num_envs, n_agents)
        self._begun = np.zeros(num_envs, np.bool_)
        self._clock = 0  # steps made so far
        self._began = np.zeros(num_envs, np.int64)  # the clock when the episode began, per sub-environment
        self._ready = False
        self._playing = np.ones(num_envs, np.bool_)  # those that have not finished
        self._some_stand = False
        self._flags = b""
        self._generators = [np.random.default_rng(0)] * num_envs  # of families in plain Python, made at each reset
        self._set_seed(seed)

    @functools.cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """The space of the observations of all sub-environments, which takes twice their memory: made when needed."""
        return batch_space(self.single_observation_space, self.num_envs)

    @functools.cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """The space of the actions of all sub-environments. `batch_space` would forget the choices."""
        return MultiDiscrete(np.tile(self.choices, (self.num_envs, 1)))

    def _connect(self) -> None:
        """Build what refers to the arrays: the state, if it is a view, and the results of `reset` and `step`."""
        if self.state_is_observations:
            self.state = self.observations.reshape(self.num_envs, -1)
        self.info: Info = {
            "agent_rewards": self.agent_rewards,
            "state": self.state,
            "action_mask": self.action_mask,
            "statistics": self.statistics,
        }
        self._returned = (self.observations, self.rewards, self.terminated, self.truncated)
        self._held = {name: getattr(self, name) for name in (*RESULTS, *INFO_ARRAYS)}
        self._zeros: dict[str, NDArray[np.float32]] = {}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        """Build the views again: copy.deepcopy and pickle turn a view of an array into a separate array."""
        if not attributes["observations"].flags.writeable:  # as Ray gives arrays to other processes
            attributes = deepcopy(attributes)
        self.__dict__.update(attributes)
        self._connect()

    def reset_env(self, e: int, rng: np.random.Generator) -> None:
        """Begin an episode in sub-environment e; its flags and rewards are already cleared.

        All that is random in this episode, here and in `step_env`, must come from rng.
        """
        raise NotImplementedError

    def step_env(self, e: int, actions: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Let the agents of sub-environment e, which has not finished, take these allowed actions, [agent]."""
        raise NotImplementedError

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """Begin episode episodes[i] in each sub-environment i of the mask; flags and rewards are already cleared."""
        for e in np.flatnonzero(mask).tolist():
            self._generators[e] = episode_generator(int(seed), e, int(episodes[e]))
            self.reset_env(e, self._generators[e])

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """Step each sub-environment of the mask `playing`, those that have not finished, and leave the others alone.

        If any action is forbidden, also one of a sub-environment that has finished, do nothing.
        Returns the index (sub-environment times n_agents plus agent) of the first forbidden action, or -1.
        """
        refused = forbidden_action(actions, self.action_mask)
        if refused < 0:
            for e in np.flatnonzero(playing).tolist():
                self.step_env(e, actions[e], self._generators[e])
        return refused

    def frame(self, index: int = 0) -> NDArray[np.uint8]:
        """A picture, uint8 [height, width, 3], of one sub-environment.

        Environments that are not of this package override this, and set `can_draw`.
        Raises ValueError where there is no picture.
        """
        if not self.picture:
            raise ValueError(f"{self.name} has no picture.")
        return importlib.import_module(self.picture).frame(self, index)  # imports Pillow

    @property
    def episode(self) -> int:
        """The number of episodes begun: the largest of the sub-environments, which masked resets can make different.

        It is the largest so that no sub-environment plays an episode a second time.
        """
        return int(self._episodes.max())

    @episode.setter
    def episode(self, episode: int) -> None:
        self._episodes[:] = episode

    def _set_seed(self, seed: int) -> None:
        seed = operator.index(seed)  # TypeError for what is no integer
        check_seed(seed)
        self.seed = seed
        self._seed = np.uint64(seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin an episode in all sub-environments, or in those of options["reset_mask"].

        A reset of all begins the same episode, number `env.episode`, in each of them. With a seed this is number 0.
        """
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f'options must be a dictionary, such as {{"reset_mask": ...}}, and not {options!r}.')
        mask = options.get("reset_mask") if options else None
        if mask is not None:
            self._check_mask(mask)
            mask = mask.copy()  # it may be the array of the flags, which are cleared below
        if seed is not None:
            self._set_seed(seed)
            super().reset(seed=self.seed)
            self._episodes[:] = 0
        if mask is None:
            mask = np.ones(self.num_envs, np.bool_)
            self._episodes[:] = self._episodes.max()
        self.rewards[mask] = 0
        self.agent_rewards[mask] = 0
        self.terminated[mask] = False
        self.truncated[mask] = False
        self.reset_envs(mask, self._seed, self._episodes)
        self._began[mask] = self._clock
        if self.checks_numbers:
            self._check_numbers()
        self._look_at_flags()
        self._episodes[mask] += 1
        if not self._ready:
            self._begun |= mask
            self._ready = bool(self._begun.all())
        observations, *_, info = self._outcome()
        return observations, info

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Let every agent act: actions are integers [num_envs, n_agents].

        Raises ValueError for actions of a wrong shape or type, out of range, or forbidden; then nothing has happened.
        Raises gymnasium.error.ResetNeeded if a sub-environment has never been reset.
        """
        if not self._ready:
            raise ResetNeeded(f"{self.name}: call reset() for every sub-environment before step().")
        if (
            type(actions) is not np.ndarray
            or actions.dtype != np.int64
            or actions.shape != self._shape
            or not actions.flags.carray  # contiguous and writeable; for other arrays Numba compiles all rules anew
        ):
            actions = self._as_actions(actions)
        refused = self.step_envs(actions, self._playing)
        if refused >= 0:
            raise self._refusal(actions, refused)
        self._clock += 1
        if self._some_stand:
            self.rewards[~self._playing] = 0
            self.agent_rewards[~self._playing] = 0
        if self.checks_numbers:
            self._check_numbers()
        self._look_at_flags()
        return self._outcome()

    def _look_at_flags(self) -> None:
        """Bring up to date which sub-environments play and which stand still."""
        flags = self.terminated.tobytes() + self.truncated.tobytes()
        if flags != self._flags:  # most steps end no episode, and comparing bytes is fast
            self._check_arrays()
            self._flags = flags
            self._playing = ~(self.terminated | self.truncated)
            self._some_stand = not self._playing.all()

    @np.errstate(invalid="ignore")
    def _check_numbers(self) -> None:
        """Raises InputError where a sub-environment has written something that is not a finite number."""
        if not self._zeros:
            names = [name for name in NUMBERS if name != "state" or not self.state_is_observations]
            self._zeros = {name: np.zeros(self._held[name].size, np.float32) for name in names}
        for name, zeros in self._zeros.items():
            # Much faster than isfinite: 0 times NaN or infinity is NaN
            if self._held[name].reshape(-1).dot(zeros) != 0:
                e = np.argwhere(~np.isfinite(self._held[name]))[0][0]
                raise InputError(
                    f"{self.name}: sub-environment {e} gives {NUMBERS[name]} that is not a finite number, in step "
                    f"{self._clock - self._began[e]} of its episode; python -m envs check looks for such faults."
                )

    def _check_arrays(self) -> None:
        """Raises InputError where a family has put another array in the place of one that callers hold."""
        for name, array in self._held.items():
            if getattr(self, name) is not array:
                raise InputError(
                    f"{self.name}: self.{name} is another array than at the start; write into that one, as in "
                    f"self.{name}[:] = ..., since callers hold it."
                )

    def _outcome(self) -> tuple[Any, Any, Any, Any, Info]:
        """The five results of a step: the arrays themselves, or copies of them that the caller may keep."""
        if not self.copy:
            return (*self._returned, self.info.copy())  # a dictionary of the caller's own: wrappers change its entries
        observations = self.observations.copy()
        info = {
            "agent_rewards": self.agent_rewards.copy(),
            "state": observations.reshape(self.state.shape) if self.state_is_observations else self.state.copy(),
            "action_mask": self.action_mask.copy(),
            "statistics": {name: values.copy() for name, values in self.statistics.items()},
        }
        return observations, self.rewards.copy(), self.terminated.copy(), self.truncated.copy(), info

    def _as_actions(self, actions: Any) -> NDArray[np.int64]:
        """Actions of any integer type, lists included, as the array that the compiled rules take."""
        array = np.asarray(actions)
        if array.shape != self._shape:
            raise ValueError(
                f"{self.name}: actions have the shape {array.shape}, not (num_envs, n_agents) = {self._shape}."
            )
        if array.dtype.kind not in "iu":
            raise ValueError(f"{self.name}: actions are {array.dtype}, not integers.")
        return array.astype(np.int64, order="C")

    def _refusal(self, actions: NDArray[np.int64], refused: int) -> ValueError:
        index, agent = divmod(refused, self.n_agents)
        action = int(actions[index, agent])
        why = (
            "is forbidden by the action mask"
            if 0 <= action < self.n_actions
            else f"does not exist; actions are 0 to {self.n_actions - 1}"
        )
        return ValueError(f"{self.name}: sub-environment {index}, agent {agent}: action {action} {why}.")

    def _check_mask(self, mask: Any) -> None:
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError('options["reset_mask"] must be a NumPy array of booleans.')
        if mask.shape != (self.num_envs,):
            raise ValueError(f'options["reset_mask"] has the shape {mask.shape}, not ({self.num_envs},).')
        if not mask.any():
            raise ValueError('options["reset_mask"] names no sub-environment.')


class EpisodeTotals:
    """Adds up one episode of each sub-environment while those that have ended wait for the others."""

    def __init__(self, env: VectorEnv) -> None:
        """To be made at a reset of all sub-environments."""
        self.teams = np.array(env.teams)
        self.ended = np.zeros(env.num_envs, np.bool_)
        self.lengths = np.zeros(env.num_envs)
        self.returns = np.zeros(env.num_envs)
        self.agent_returns = np.zeros((env.num_envs, env.n_agents))
        self.statistics = {name: np.zeros(env.num_envs) for name in env.statistics}

    def add(
        self,
        rewards: NDArray[np.float32],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        info: Info,
    ) -> None:
        """Adds a step."""
        self.lengths += ~self.ended
        self.returns += rewards
        self.agent_returns += info["agent_rewards"]
        ends_now = (terminated | truncated) & ~self.ended
        for name, values in info["statistics"].items():  # those of foreign games are known only when one ends
            self.statistics.setdefault(name, np.full(len(self.ended), np.nan))[ends_now] = values[ends_now]
        self.ended |= ends_now

    def episodes(self) -> list[dict[str, float]]:
        """What `means` averages, for each episode: return, length, mean returns of other teams, statistics."""
        columns = {"episode": np.arange(len(self.ended)), "return": self.returns, "episode_length": self.lengths}
        for team in sorted(set(self.teams.tolist()) - {0}):
            columns[f"team_{team}_return"] = self.agent_returns[:, self.teams == team].mean(axis=1)
        columns |= self.statistics
        return [dict(zip(columns, values)) for values in zip(*(column.tolist() for column in columns.values()))]

    def means(self) -> dict[str, float]:
        """Means over the episodes: return_mean, return_std and episode_length, what the family reports, and the mean
        returns of the members of other teams than team 0, whose return is the first. A statistic that is not a number
        (of a game that crashed) does not count."""
        means = {
            "return_mean": self.returns.mean(),
            "return_std": self.returns.std(),
            "episode_length": self.lengths.mean(),
        }
        for team in sorted(set(self.teams.tolist()) - {0}):
            means[f"team_{team}_return_mean"] = self.agent_returns[:, self.teams == team].mean()
        for name, values in self.statistics.items():
            means[name] = np.nanmean(values) if np.isfinite(values).any() else np.nan
        return {name: float(value) for name, value in means.items()}
