"""Environments that are not ours: any from PettingZoo, and those of Gymnasium in which one or several agents act.

    pettingzoo:<module>      a module with a function `parallel_env`, such as pettingzoo:mpe2.simple_spread_v3
    gymnasium:<id>           such as gymnasium:lbforaging:Foraging-8x8-2p-3f-v3

Modules are looked for among the installed ones and in the current folder. The environment is built with the keyword
arguments `env_kwargs`. In Gymnasium a tuple of action spaces means several agents, and a single one means one agent.

Actions are choices, from 0 on. A MultiDiscrete or MultiBinary action is one choice among all combinations of its parts,
of which there may be 1,024. With `action_bins` a Box is one among all combinations of so many equally distant values in
each dimension.

Observations are vectors. A table of numbers, such as 27 entities of 5 values, is laid out as one. Images become vectors
only with `flatten_images`: arrays of three and more dimensions, and those of bytes with two. Images of bytes from 0 to
255 are divided by 255, since networks learn little from large numbers. Where such an image has codes, of kinds and
colours for example, little is left of them: a warning says so, and `divide_images` turned off leaves them. Other
numbers stay as they are.

What the contract in `envs.vector` asks for is made as follows:

    observations   padded at the end with zeros to the largest agent. Zeros alone for an agent that has left the game
    action_mask    from the observation ({"observation": .., "action_mask": ..}) or from the info. It forbids what an
                   agent with fewer actions than another lacks. Agents that have left may only take action 0. An agent
                   that has had a mask must have one until the episode ends. Masks of the parts of a MultiDiscrete or
                   MultiBinary action allow the combinations whose parts are all allowed
    agent_rewards  as the environment gives them. Where it has one reward for all, each agent has that
    rewards        the sum of the agents' rewards, as in the paper, or the one reward for all. Where the environment
                   has an attribute `teams` (a number for each agent), the sum over team 0. Where there is none, and
                   agents with other names earn something else, a warning says so once
    state          what the environment's function `state` returns, if that is a vector, a table, or a dictionary of
                   these, or an image and `flatten_images` is given; otherwise the agents' observations
    statistics     the numbers in the info of an episode's last step, such as info["won"]. In PettingZoo, where each
                   agent has an info, their mean over team 0
    terminated     the last agents have left, and the clock is not the reason
    truncated      the clock is the reason, for at least one of the last agents. The clock is the environment's own or
                   `max_episode_steps`, whichever is first

The packages lbforaging and rware call the end of their clock a termination. So where an environment of Gymnasium counts
its steps itself, an end in the last of these steps is a truncation here.

The seed of each episode's `reset` is derived from (seed, sub-environment, number of the episode). So the same seed
plays the same episodes, and a resumed run goes on exactly, if the environment draws everything from that seed.

Worker processes know the ids that Gymnasium has, and those that the module in <module>:<id> registers.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import math
import numbers
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs import vector
from envs.adapters.actions import Actions
from envs.adapters.observations import flattened
from envs.faults import in_words, is_ours, place
from envs.settings import Settings, no_arguments, torch_modes
from envs.vector import RESULT_COLUMNS, InputError
from envs.workers import NO_MAIN, Games, close, hidden_main

# Where environments keep the number of steps after which they end an episode
CLOCKS = ("max_cycles", "max_steps", "max_episode_steps", "_max_episode_steps", "episode_limit")

LARGEST = float(np.finfo(np.float32).max)

CODES = 20  # an image of bytes without a larger value has codes


class Source(NamedTuple):
    """What an environment is built from."""

    name: str  # of the task
    target: str  # the module, or Gymnasium's id
    kwargs: Mapping[str, Any]
    max_episode_steps: int  # 0: the environment's own clock
    flatten_images: bool
    divide_images: bool
    action_bins: int
    pictures: bool  # whether it shall be able to draw itself


class Outcome(NamedTuple):
    """What a reset or a step of one sub-environment leads to."""

    observations: NDArray[np.float32]  # [agent, value]
    action_mask: NDArray[np.bool_]  # [agent, action]
    state: NDArray[np.float32] | None  # [value]
    reward: float
    agent_rewards: NDArray[np.float32]  # [agent]
    terminated: bool
    truncated: bool
    statistics: Mapping[str, float]  # at the end of an episode


def understood(play: Callable[[Any, Any], Outcome]) -> Callable[[Any, Any], Outcome]:
    """A method of `Game`: what a game returns may be anything, and an error that comes of it is a sentence, too."""

    @functools.wraps(play)
    def wrapped(game: Any, given: Any) -> Outcome:
        try:
            return play(game, given)
        except Exception as error:
            game.blame(f"in {play.__name__}", error)
            raise

    return wrapped


class Game:
    """One environment, with agents by number. The two classes below know the interfaces."""

    rules = ""  # what the interface asks of reset and step

    def __init__(self, source: Source) -> None:
        """Raises InputError for what cannot be built, and as `look_at`."""
        self.name, self.flatten_images, self.divide_images = source.name, source.flatten_images, source.divide_images
        self.own = Settings.now()  # the game's, while its code runs
        self.same = True  # whether they are ours
        with self.told("when it is built"):
            self.env = self.build(source, {})
        metadata = getattr(self.env, "metadata", None)
        modes = metadata.get("render_modes") if isinstance(metadata, Mapping) else None
        self.can_draw = source.pictures and "rgb_array" in (modes or ())
        if self.can_draw and "render_mode" not in source.kwargs:
            self.close()  # only here: to close a game can end pygame for all others
            with self.told("when it is built"):
                try:
                    self.env = self.build(source, {"render_mode": "rgb_array"})
                except InputError:  # it names the mode, but takes no such argument
                    self.can_draw = False
                    self.env = self.build(source, {})

        try:
            self.look_at(source)
        except BaseException as error:
            close([self])
            self.blame("when it is looked at", error)
            raise

    def look_at(self, source: Source) -> None:
        """Finds sizes and limits, and begins an episode. Raises InputError for what these algorithms cannot play."""
        observation_spaces, action_spaces = self.spaces()
        self.n_agents = len(action_spaces)
        if not self.n_agents:
            raise InputError(f"{self.name} has no agents.")
        if source.action_bins and not any(isinstance(space, spaces.Box) for space in action_spaces):
            raise InputError(f"{self.name} has no continuous actions, and `action_bins` is for these.")
        self.actions = [Actions(self.name, space, source.action_bins) for space in action_spaces]
        self.choices = tuple(actions.n for actions in self.actions)
        self.spaces_seen = [self.space_seen(space) for space in observation_spaces]
        flat: list[Any] = []
        sizes = [0]
        with contextlib.suppress(NotImplementedError, ValueError):  # such as a space of texts of the package's own
            sizes = [spaces.flatdim(space) for space in self.spaces_seen]
        check_memory(self.name, 1, 20 * sum(sizes))  # for each value bounds of 8 bytes and a divisor
        with contextlib.suppress(NotImplementedError):
            nothing = spaces.Box(0, 1, (0,))  # of an empty dictionary, for which Gymnasium has no vector
            flat = [spaces.flatten_space(space) if leaves(space) else nothing for space in self.spaces_seen]
        if not flat or not all(isinstance(space, spaces.Box) for space in flat):
            raise InputError(f"{self.name} has observations without a fixed size: {observation_spaces[0]}.")
        self.obs_size = max(int(space.shape[0]) for space in flat)
        self.scales = [scale(space, source.divide_images) for space in self.spaces_seen]
        lows = [(space.low / scale).min(initial=0) for space, scale in zip(flat, self.scales)]
        highs = [(space.high / scale).max(initial=0) for space, scale in zip(flat, self.scales)]
        self.low = max(float(min(0.0, *lows)), -LARGEST)  # 0: the padding
        self.high = min(float(max(0.0, *highs)), LARGEST)
        teams = self.teams()
        if teams is not None and (len(teams) != self.n_agents or 0 not in teams):
            raise InputError(f"{self.name}: its teams {teams} are not a number for each agent, from 0 on.")
        self.team = [agent for agent in range(self.n_agents) if teams is None or teams[agent] == 0]

        self.own_clock = self.find_clock()
        self.clock = source.max_episode_steps or self.own_clock
        if not self.clock:
            raise InputError(f"{self.name} says nowhere how long an episode lasts; `max_episode_steps` does.")
        self.clock_is_guessed = not source.max_episode_steps
        self.steps = 0
        self.masked: set[int] = set()  # agents that have had a mask in this episode
        self.state_size = -1  # not known yet
        state = self.reset(0).state
        self.state_size = 0 if state is None else len(state)

    def build(self, source: Source, more: Mapping[str, Any]) -> Any:
        """The environment, with more keyword arguments than the user gave."""
        raise NotImplementedError

    def spaces(self) -> tuple[list[Any], list[Any]]:
        """The observation space and the action space of each agent."""
        raise NotImplementedError

    def find_clock(self) -> int:
        """The number of steps after which the environment itself ends an episode; 0: it does not say."""
        raise NotImplementedError

    def teams(self) -> tuple[int, ...] | None:
        """The number of each agent's team, or None where the environment does not say. InputError for anything else."""
        raise NotImplementedError

    def names(self) -> list[str] | None:
        """The agents' names, or None where they have none."""
        return None

    def reset(self, seed: int) -> Outcome:
        """Begins an episode."""
        raise NotImplementedError

    def step(self, actions: list[int]) -> Outcome:
        """Lets all agents act."""
        raise NotImplementedError

    def frame(self) -> NDArray[np.uint8]:
        """The environment's own picture of itself."""
        with self.told("in render"):
            picture = self.env.render()
        if not isinstance(picture, np.ndarray) or picture.ndim != 3 or not np.issubdtype(picture.dtype, np.integer):
            found = f"{picture.dtype} {picture.shape}" if isinstance(picture, np.ndarray) else type(picture).__name__
            raise InputError(
                f"{self.name}: its render gives {found}, and no picture [height, width, 3] of integers from 0 to 255."
            )
        return picture[..., :3].astype(np.uint8)

    def close(self) -> None:
        """Closes the environment."""
        if callable(ending := getattr(self.env, "close", None)):
            with self.told("in close"):
                ending()

    @contextlib.contextmanager
    def told(self, where: str) -> Iterator[None]:
        """An error of the game becomes a sentence that says so, and one at the border says what the interface asks.

        Where the game has settings of its own, they hold here.
        """
        self.ours = ours = Settings.now()
        self.own.hold(ours)
        try:
            with hidden_main():  # the game may start a process
                yield
        except BaseException as error:
            self.blame(where, error)
            raise
        finally:
            self.own = Settings.now()
            self.same = self.own == ours
            ours.hold(self.own)

    def env_step(self, actions: Any) -> Any:
        """The game's step, as in `told`, but in little time where its settings are ours.

        Of these each step looks at PyTorch's first two alone, and `look_again` at the others.
        """
        before = torch_modes()
        if not self.same or before != self.own[:2]:
            with self.told("in step"):
                return self.env.step(actions)
        main = sys.modules["__main__"]
        sys.modules["__main__"] = NO_MAIN
        try:
            return self.env.step(actions)
        except BaseException as error:
            self.blame("in step", error)
            raise
        finally:
            sys.modules["__main__"] = main
            if torch_modes() != before:
                self.look_again(before)

    def look_again(self, modes: tuple[Any, Any]) -> None:
        """Looks for all settings that the game has made in its steps: they are its own, too.

        modes: PyTorch's first two, as they are ours.
        """
        now = Settings.now()
        ours = self.ours._replace(dtype=modes[0], gradients=modes[1])
        if now != ours:
            self.own, self.same = now, False
            ours.hold(now)

    def blame(self, where: str, error: BaseException) -> None:
        """Raises InputError with a sentence about an error of the game's; not about a signal that ends the program."""
        if isinstance(error, InputError | KeyboardInterrupt) or (not isinstance(error, Exception) and is_ours(error)):
            return
        rules = f"{self.name}: {self.rules};" if where in ("in reset", "in step") else f"{self.name} fails {where} with"
        raise InputError(fault(self.name, where, error) or f"{rules} {in_words(error)}") from error

    def returned(self, method: str, result: Any, kinds: tuple[type, ...]) -> Any:
        """What reset or step gave, if it has these parts. Raises InputError for an older interface, such as Gym's."""
        if isinstance(result, tuple | list) and len(result) == len(kinds):
            if all(isinstance(part, kind) for part, kind in zip(result, kinds)):
                return result
            found = ", ".join(type(part).__name__ for part in result)
        else:
            found = f"{len(result)} values" if isinstance(result, tuple | list) else type(result).__name__
        raise InputError(f"{self.name}: {self.rules}; {method} returns {found}.")

    def space_seen(self, space: Any) -> Any:
        """An agent's observation space without its action mask."""
        if isinstance(space, spaces.Dict):
            parts = {name: part for name, part in space.spaces.items() if name != "action_mask"}
            space = parts["observation"] if list(parts) == ["observation"] else spaces.Dict(parts)
        images = [part.shape for part in leaves(space) if isinstance(part, spaces.Box) and is_image(part)]
        if images and not self.flatten_images:
            what = f"observations of the shape {images[0]}, not vectors"
            raise InputError(f"{self.name} has {what}; `flatten_images` makes vectors of them.")
        return space

    def outcome(
        self,
        seen: list[Any],
        masks: list[Any],
        agent_rewards: list[float],
        reward: float,
        terminated: bool,
        truncated: bool,
        statistics: Mapping[str, float] | None = None,
    ) -> Outcome:
        """The contract's arrays. seen, masks: of each agent; None if it has left, or if there is no mask."""
        if self.steps == 0:
            self.masked.clear()
        if self.same and (terminated or truncated):
            self.look_again(torch_modes())
        observations = np.zeros((self.n_agents, self.obs_size), np.float32)
        action_mask = np.zeros((self.n_agents, max(self.choices)), np.bool_)
        for i, observation in enumerate(seen):
            if observation is None:
                action_mask[i, 0] = True
                continue
            mask = masks[i]
            if isinstance(observation, Mapping):
                mask = observation.get("action_mask", mask)
            values = self.vector(observation, self.spaces_seen[i])
            observations[i, : len(values)] = values / self.scales[i]
            if mask is not None:
                self.masked.add(i)
            elif i in self.masked and not terminated and not truncated:  # at an end nobody acts any more
                raise InputError(
                    f"{self.name}: agent {i} has no action mask after step {self.steps} of the episode, and had one "
                    "before; a mask must come with each observation."
                )
            action_mask[i, : self.choices[i]] = True if mask is None else self.allowed(i, mask)
            if not action_mask[i].any():  # the agent has to wait
                action_mask[i, 0] = True
        own = np.array(agent_rewards, np.float32)
        return Outcome(observations, action_mask, self.state(), reward, own, terminated, truncated, statistics or {})

    def vector(self, observation: Any, space: Any) -> NDArray[np.float32]:
        """What an agent sees, as [value]. Raises InputError where it does not fit the space that was declared."""
        within = isinstance(space, spaces.Dict) and "observation" in space.spaces
        if isinstance(observation, Mapping) and "observation" in observation and not within:
            observation = observation["observation"]
        try:
            return flattened(space, observation)
        except (ValueError, TypeError, KeyError, IndexError, RuntimeError) as error:  # RuntimeError: PyTorch's
            raise InputError(f"{self.name}: an observation does not fit its space {space}: {error}.") from error

    def allowed(self, agent: int, mask: Any) -> NDArray[np.bool_]:
        """What an action mask allows: [action]. Raises InputError for what is no mask of these actions."""
        try:
            return self.actions[agent].mask(agent, mask)
        except InputError:
            raise
        except (ValueError, TypeError, KeyError, RuntimeError):
            choices = self.choices[agent]
            raise InputError(f"{self.name}: agent {agent} has {choices} actions and the action mask {mask}.") from None

    @functools.cached_property
    def state_function(self) -> Callable[[], Any] | None:
        """The environment's function of that name, if it has one; wrappers take a while to look for it."""
        found = [getattr(env, "state", None) for env in (self.env, self.env.unwrapped)]
        return next((each for each in found if callable(each)), None)

    def state(self) -> NDArray[np.float32] | None:
        """What the environment calls its state, as a vector; None if it has none, or an image that is not wanted."""
        said, function = None, self.state_function
        with contextlib.nullcontext() if self.same else self.told("in state"):
            try:
                said = None if function is None else function()
            except NotImplementedError:  # PettingZoo's function, where an environment has none of its own
                pass
            except BaseException as error:
                # A wrapper of PettingZoo calls what an environment within calls its state, though that is no function.
                if not isinstance(error, TypeError) or "is not callable" not in str(error):
                    self.blame("in state", error)
                    raise
        try:
            state = None if said is None else as_vector(said)
        except (TypeError, ValueError, RuntimeError) as error:
            if self.state_size > 0:
                raise InputError(f"{self.name}: its state is not an array of numbers: {error}.") from error
            if self.state_size < 0:
                warnings.warn(
                    f"{self.name}: its state is not an array of numbers, so the agents' observations take its place.",
                    stacklevel=2,
                )
            state = None
        if state is not None and isinstance(said, np.ndarray) and is_image(said):
            bytes = said.dtype == np.uint8 and self.divide_images
            state = state / np.float32(255 if bytes else 1) if self.flatten_images else None
        size = 0 if state is None else state.size
        if self.state_size not in (-1, size):
            raise InputError(f"{self.name}: its state has {size} values now, and had {self.state_size}.")
        return None if state is None else state.ravel()

    def number(self, reward: Any) -> float:
        """A reward, which may be an array of one value. Raises InputError for anything else."""
        if isinstance(reward, float):  # also NumPy's usual ones
            return float(reward)
        with contextlib.suppress(TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that has a gradient
            given = np.asarray(reward)
            if given.dtype.kind in "biufO":  # NumPy makes numbers of texts and complex numbers, too
                return float(given.item())
        raise InputError(f"{self.name}: {reward!r} is no reward.")

    def sum_over_team(self, agent_rewards: list[float]) -> float:
        """The reward of team 0."""
        return float(sum(agent_rewards[agent] for agent in self.team))

    def check_clock(self) -> None:
        """Raises InputError where an environment goes on longer than it seemed to say."""
        if self.clock_is_guessed:
            raise InputError(
                f"{self.name} goes on after {self.clock} steps, which seemed to be its limit; "
                "`max_episode_steps` says how long an episode lasts."
            )


def check_memory(name: str, num_envs: int, room: int) -> None:
    """Raises InputError where an environment needs more bytes than there are, before they are written, and so taken."""
    if room < 2**28:  # it takes a while to look at the memory
        return
    import psutil

    if room > (free := psutil.virtual_memory().available):
        raise InputError(
            f"{name} with num_envs={num_envs} does not fit into this machine's memory: it takes at least "
            f"{room / 2**20:,.0f} MiB, and {free / 2**20:,.0f} are free."
        )


def look_here() -> None:
    """Lets imports find modules in the current folder; for a script, Python looks only into the script's own."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def import_module(name: str, target: str) -> Any:
    """A module that is installed or lies in the current folder. Raises InputError, about the task, if there is none."""
    look_here()
    if target.startswith("."):
        raise InputError(f"{name}: {target} is not the name of a module.")
    try:
        with no_arguments():
            return importlib.import_module(target)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{target}.".startswith(f"{error.name}."):
            raise InputError(f"{name} needs the module {error.name}, which is not installed{taken(error)}.") from error
    except ImportError as error:  # such as PettingZoo's words on what has moved to another package
        raise InputError(f"{name}: {error}{taken(error)}") from error
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or (not isinstance(error, Exception) and is_ours(error)):
            raise
        raise InputError(fault(name, "when it is imported", error) or f"{name}: {in_words(error)}") from error
    parent, _, last = target.rpartition(".")
    retired = getattr(sys.modules.get(parent), last, None)  # what PettingZoo has in the place of its old versions
    if retired is None:
        raise InputError(f"{name}: there is no module {target}, neither installed nor in the current folder.")
    return retired


def taken(error: ImportError) -> str:
    """What is to be said where a game has looked for a module of its own and found one of this project's."""
    first = f"{error.name}".partition(".")[0]
    file = getattr(sys.modules.get(first), "__file__", None)
    root = Path(__file__).parents[2]
    if file is None or Path(file).parent not in [root / folder for folder in ("algos", "benchmark", "envs")]:
        return ""
    return f"; the name `{first}` is this project's, so a package of the game needs another one"


def fault(name: str, where: str, error: BaseException) -> str | None:
    """A sentence about an error in the code of a game; None if it came up before the game did anything."""
    found = place(error)
    return None if found is None else f"{name}: the game's own code fails {where} ({found}) with {in_words(error)}"


def unbuilt(source: Source, error: BaseException) -> BaseException:
    """Why a game could not be built: an error of its own, or what it was called with. Signals stay what they are."""
    if isinstance(error, KeyboardInterrupt) or (not isinstance(error, Exception) and is_ours(error)):
        return error
    own = None if isinstance(error, ImportError) else fault(source.name, "when it is built", error)
    given = f"; it was given {dict(source.kwargs)}" if own and source.kwargs else ""
    return InputError(f"{own or f'{source.name}: {error}'}{given}")


def is_image(array: Any) -> bool:
    """Whether an array, or a Box, is an image, and not a vector or a table of numbers."""
    return len(array.shape) > 2 or (len(array.shape) == 2 and array.dtype == np.uint8)


def as_vector(said: Any) -> NDArray[np.float32]:
    """An array of numbers, or a dictionary of such by name, as one vector. TypeError or ValueError for other things."""
    if isinstance(said, Mapping):
        parts = [as_vector(said[name]).ravel() for name in sorted(said, key=str)]
        return np.concatenate(parts) if parts else np.zeros(0, np.float32)
    return np.asarray(said, np.float32)


def scale(space: Any, divide_images: bool) -> NDArray[np.float32]:
    """What the values of a flattened observation are divided by: 255 for those of images of bytes, else 1."""
    parts = []
    for leaf in leaves(space) if divide_images else []:
        bytes = isinstance(leaf, spaces.Box) and is_image(leaf) and leaf.dtype == np.uint8 and leaf.high.max() == 255
        parts.append(np.full(spaces.flatdim(leaf), 255 if bytes else 1, np.float32))
    return np.concatenate(parts) if parts else np.ones(spaces.flatdim(space), np.float32)


def reported(info: Mapping[Any, Any]) -> dict[str, float]:
    """The numbers in an info, by names that results of runs do not have already."""
    found = {}
    for key, value in info.items():
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value.item()
        if not isinstance(value, bool | np.bool_ | numbers.Real):
            continue
        try:
            number = float(value)
        except OverflowError:  # a whole number beyond all others
            continue
        if abs(number) < LARGEST:
            name = str(key).encode(errors="replace").decode()  # some texts cannot be written
            own = name
            while own.startswith("info_"):  # `info_seed` and `seed` stay two
                own = own.removeprefix("info_")
            taken = own in RESULT_COLUMNS or own.startswith("team_") or not own
            found[f"info_{name}" if taken else name] = number
    return found


def leaves(space: Any) -> list[Any]:
    """The spaces that a tuple or a dictionary of spaces consists of."""
    if isinstance(space, spaces.Dict):
        return [leaf for part in space.spaces.values() for leaf in leaves(part)]
    if isinstance(space, spaces.Tuple):
        return [leaf for part in space.spaces for leaf in leaves(part)]
    return [space]


class ParallelGame(Game):
    """An environment of PettingZoo, by its parallel interface."""

    rules = (
        "reset(seed=..., options=...) must return two dictionaries by agent, observations and infos, and step(actions) "
        "five: observations, rewards, terminations, truncations and infos"
    )

    def build(self, source: Source, more: Mapping[str, Any]) -> Any:
        """See `Game`."""
        module = import_module(source.name, source.target)
        make = getattr(module, "parallel_env", None)
        if make is None and hasattr(module, "env"):
            raise InputError(f"{source.name} has agents that act in turn (PettingZoo's AEC), not all at once.")
        if make is None:
            raise InputError(f"{source.name}: the module has no function parallel_env, as those of PettingZoo have.")
        try:
            env = make(**{**source.kwargs, **more})
        except BaseException as error:  # also of a retired version, or a missing package
            raise unbuilt(source, error) from error
        if not hasattr(env, "possible_agents"):
            raise InputError(f"{source.name} has no possible_agents, which tell its agents before an episode begins.")
        if not isinstance(getattr(env, "metadata", None), Mapping):
            env.metadata = {}  # PettingZoo's own functions look into it
        self.agents = list(env.possible_agents)
        if len(set(self.agents)) < len(self.agents):
            raise InputError(f"{source.name} has agents of the same name: its possible_agents are {self.agents}.")
        self.playing = set(self.agents)
        return env

    def spaces(self) -> tuple[list[Any], list[Any]]:
        """See `Game`."""
        try:
            observation_spaces = [self.env.observation_space(agent) for agent in self.agents]
            return observation_spaces, [self.env.action_space(agent) for agent in self.agents]
        except Exception as error:
            rule = "observation_space(agent) and action_space(agent) must be functions that return a space"
            said = fault(self.name, "in its spaces", error) or f"{self.name}: {rule}; {in_words(error)}"
            raise InputError(said) from error

    def find_clock(self) -> int:
        """See `Game`. Some environments are wrapped more than once."""
        env = self.env
        for _ in range(5):
            env = getattr(env, "unwrapped", env)
            found = clock_of(env)
            if found:
                return found
            env = getattr(env, "env", None) or getattr(env, "aec_env", None)
        return 0

    def teams(self) -> tuple[int, ...] | None:
        """See `Game`."""
        teams = getattr(self.env.unwrapped, "teams", None)
        try:
            return None if teams is None else tuple(int(teams[agent]) for agent in self.agents)
        except (TypeError, ValueError, KeyError, IndexError, OverflowError):
            raise InputError(f"{self.name}: its teams {teams} are not a number for each agent, by name.") from None

    def names(self) -> list[str] | None:
        """See `Game`."""
        return [str(agent) for agent in self.agents]

    @understood
    def reset(self, seed: int) -> Outcome:
        """See `Game`."""
        with self.told("in reset"):
            result, agents = self.env.reset(seed=seed), self.env.agents
        observations, infos = self.returned("reset", result, (Mapping,) * 2)
        self.steps = 0
        self.playing = self.known(agents, observations)
        if not self.playing:
            raise InputError(f"{self.name} has no agents in `agents` after its reset.")
        seen = [observations.get(agent) if agent in self.playing else None for agent in self.agents]
        return self.outcome(seen, self.masks(infos), [0.0] * self.n_agents, 0.0, False, False)

    @understood
    def step(self, actions: list[int]) -> Outcome:
        """See `Game`."""
        choices = zip(self.agents, self.actions, actions)
        chosen = {agent: own[action] for agent, own, action in choices if agent in self.playing}
        result = self.env_step(chosen)
        observations, rewards, terminations, truncations, infos = self.returned("step", result, (Mapping,) * 5)
        self.steps += 1
        left = {agent for flags in (terminations, truncations) for agent in flags if flags[agent]}
        timed_out = any(truncations.get(agent) and not terminations.get(agent) for agent in self.playing)
        acted = self.playing
        self.playing = self.known(set(self.env.agents) - left, observations)
        ended = not self.playing
        if not ended and self.steps == self.clock:
            self.check_clock()
            ended = timed_out = True
        present = acted if ended else self.playing  # those who acted last see what it led to
        if unpaid := acted - set(rewards):
            raise InputError(f"{self.name}: the agents {sorted(map(str, unpaid))} have acted and get no reward.")
        seen = [observations.get(agent) if agent in present else None for agent in self.agents]
        own = [self.number(rewards.get(agent, 0)) for agent in self.agents]
        reward = self.sum_over_team(own)
        ends = ended and not timed_out, ended and timed_out
        return self.outcome(seen, self.masks(infos), own, reward, *ends, self.statistics(infos) if ended else None)

    def statistics(self, infos: Mapping[str, Any]) -> dict[str, float]:
        """The mean over team 0 of each number in the agents' infos."""
        own = [reported(infos.get(self.agents[agent]) or {}) for agent in self.team]
        names = dict.fromkeys(name for each in own for name in each)
        return {name: float(np.mean([each[name] for each in own if name in each])) for name in names}

    def known(self, agents: Iterable[Any], observations: Mapping[str, Any]) -> set[Any]:
        """The agents as a set. Raises InputError for one that `possible_agents` did not name, or that sees nothing."""
        if unknown := set(agents) - set(self.agents):
            raise InputError(f"{self.name}: the agents {sorted(map(str, unknown))} are not among its possible_agents.")
        if blind := {agent for agent in agents if observations.get(agent) is None}:
            raise InputError(f"{self.name}: the agents {sorted(map(str, blind))} play on without an observation.")
        return set(agents)

    def masks(self, infos: Mapping[str, Any]) -> list[Any]:
        """The agents' action masks in the infos, or None."""
        return [(infos.get(agent) or {}).get("action_mask") for agent in self.agents]


class TupleGame(Game):
    """An environment of Gymnasium: several agents, by tuples, or one."""

    rules = (
        "reset(seed=..., options=...) must return observations and a dictionary, the info, and step(actions) five "
        "things: observations, rewards, terminated, truncated and info"
    )

    def build(self, source: Source, more: Mapping[str, Any]) -> Any:
        """See `Game`."""
        look_here()  # for the module in <module>:<id>
        try:
            with no_arguments():
                return gymnasium.make(source.target, disable_env_checker=True, **{**source.kwargs, **more})
        except BaseException as error:
            raise unbuilt(source, error) from error

    def spaces(self) -> tuple[list[Any], list[Any]]:
        """See `Game`."""
        observation_space, action_space = self.env.observation_space, self.env.action_space
        if isinstance(action_space, Mapping):  # also Gymnasium's Dict
            raise InputError(
                f"{self.name} has a dictionary of actions by agent, as PettingZoo's environments have; with a wrapper "
                "that makes it a ParallelEnv (its package may have one), it is played as pettingzoo:<module>."
            )
        self.one_agent = not isinstance(action_space, spaces.Tuple)
        if self.one_agent:
            return [observation_space], [action_space]
        if not isinstance(observation_space, spaces.Tuple) or len(observation_space) != len(action_space):
            raise InputError(f"{self.name} has a tuple of actions, but not one observation for each.")
        return list(observation_space), list(action_space)

    def find_clock(self) -> int:
        """See `Game`."""
        outside = self.env.spec.max_episode_steps or 0  # Gymnasium's own wrapper truncates
        self.counts_itself = not outside
        return outside or clock_of(self.env.unwrapped)

    def teams(self) -> tuple[int, ...] | None:
        """See `Game`."""
        teams = getattr(self.env.unwrapped, "teams", None)
        try:
            return None if teams is None else tuple(int(team) for team in teams)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self.name}: its teams {teams} are not a number for each agent.") from None

    @understood
    def reset(self, seed: int) -> Outcome:
        """See `Game`."""
        with self.told("in reset"):
            result = self.env.reset(seed=seed)
        observations, info = self.returned("reset", result, (object, Mapping))
        self.steps = 0
        return self.outcome(self.seen(observations), self.masks(info), [0.0] * self.n_agents, 0.0, False, False)

    @understood
    def step(self, actions: list[int]) -> Outcome:
        """See `Game`."""
        chosen = tuple(own[action] for own, action in zip(self.actions, actions))
        result = self.env_step(chosen[0] if self.one_agent else chosen)
        observations, rewards, ends, time_outs, info = self.returned("step", result, (*(object,) * 4, Mapping))
        self.steps += 1
        for flags in (ends, time_outs):
            if isinstance(flags, Mapping) or np.shape(flags) not in ((), (self.n_agents,)):
                raise InputError(f"{self.name}: {flags} is neither one flag nor one for each agent.")
        terminated, truncated = bool(np.all(ends)), bool(np.any(time_outs))
        if terminated and self.counts_itself and self.steps == self.own_clock:
            truncated = True
        elif not terminated and not truncated and self.steps == self.clock:
            self.check_clock()
            truncated = True
        elif terminated:
            truncated = False
        if np.ndim(rewards) == 0:
            own, reward = [float(rewards)] * self.n_agents, float(rewards)
        else:
            own = [self.number(value) for value in self.by_agent(rewards)]
            reward = self.sum_over_team(own)
        statistics = reported(info) if terminated or truncated else None
        seen, masks = self.seen(observations), self.masks(info)
        return self.outcome(seen, masks, own, reward, terminated and not truncated, truncated, statistics)

    def masks(self, info: Mapping[str, Any]) -> list[Any]:
        """The agents' action masks in the info, or None for each."""
        masks = info.get("action_mask")
        if masks is None:
            return [None] * self.n_agents
        return self.by_agent(masks)

    def seen(self, observations: Any) -> list[Any]:
        """What each agent sees. Raises InputError where that is nothing: here nobody leaves before the end."""
        seen = self.by_agent(observations)
        if blind := [i for i, each in enumerate(seen) if each is None]:
            raise InputError(f"{self.name}: agent {blind[0]} has no observation.")
        return seen

    def by_agent(self, parts: Any) -> list[Any]:
        """What an environment gave for each agent. Raises InputError where these are not as many."""
        if self.one_agent:
            return [parts]
        listed = isinstance(parts, list | tuple) or (isinstance(parts, np.ndarray) and parts.ndim > 0)
        if not listed or len(parts) != self.n_agents:
            raise InputError(f"{self.name} has {self.n_agents} agents, and {parts} is not one thing for each.")
        return list(parts)


def clock_of(env: Any) -> int:
    """The number of steps that an environment keeps under one of the usual names, or 0."""
    for name in CLOCKS:
        value = getattr(env, name, None)
        if isinstance(value, int | np.integer) and not isinstance(value, bool) and value > 0:
            return int(value)
    return 0


def parse_kwargs(text: str) -> dict[str, Any]:
    """Keyword arguments as they stand in a call, "N=2, local_ratio=0.5". Raises InputError for anything else."""
    try:
        call = ast.parse(f"f({text})", mode="eval").body
        if isinstance(call, ast.Call) and not call.args and all(keyword.arg for keyword in call.keywords):
            return {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords}
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):  # MemoryError: very many brackets
        pass
    raise InputError(f"`env_kwargs` {text!r} is not like the arguments in a call, such as \"N=2, mode='easy'\".")


INTERFACES: dict[str, type[Game]] = {"pettingzoo": ParallelGame, "gymnasium": TupleGame}


class Env(vector.VectorEnv):
    """An environment that is not ours; see the module's docstring."""

    checks_numbers = True

    def __init__(
        self,
        name: str,
        num_envs: int,
        seed: int,
        copy: bool,
        *,
        interface: str,
        target: str,
        env_kwargs: Mapping[str, Any] | None = None,
        max_episode_steps: int = 0,
        flatten_images: bool = False,
        divide_images: bool = True,
        action_bins: int = 0,
        env_workers: int = 0,
        pictures: bool = False,
    ) -> None:
        """interface: a key of INTERFACES; target: the module or id. The others are those of `envs.make`."""
        kwargs = env_kwargs or {}
        source = Source(name, target, kwargs, max_episode_steps, flatten_images, divide_images, action_bins, pictures)
        game = INTERFACES[interface](source)  # in this process, since it says the sizes and what is wrong
        if game.can_draw:
            source = source._replace(kwargs={"render_mode": "rgb_array", **kwargs})
        source = source._replace(pictures=game.can_draw)  # no game need try this again
        check_memory(name, num_envs, num_envs * game.n_agents * (4 * game.obs_size + max(game.choices)))
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=game.n_agents,
            n_actions=max(game.choices),
            obs_size=game.obs_size,
            state_size=game.state_size or None,
            episode_limit=game.clock,
            low=game.low,
            high=game.high,
            teams=game.teams(),
            choices=game.choices,
        )
        if names := game.names():
            self.agent_names = tuple(names)
        self.can_draw = game.can_draw
        self._sides: list[list[int]] = []  # agents whose names begin alike, where these may be sides that oppose
        if game.teams() is None and names:
            kinds = dict.fromkeys(kind_of(name) for name in names)
            self._sides = [[i for i, name in enumerate(names) if kind_of(name) == kind] for kind in kinds]
        images = np.zeros((game.n_agents, game.obs_size), np.bool_)  # whose values are divided
        for i, divisors in enumerate(game.scales):
            images[i, : len(divisors)] = divisors > 1
        self._images = images if images.any() else None
        self._brightest = 0.0
        game.close()
        self.games = Games(name, functools.partial(INTERFACES[interface], source), num_envs, env_workers)

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        if mask.all():
            self.statistics.clear()  # what results say must not depend on episodes before
        chosen = np.flatnonzero(mask).tolist()
        self._play("reset", {e: (vector.episode_seed(int(seed), e, int(episodes[e])),) for e in chosen})

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        refused = vector.forbidden_action(actions, self.action_mask)
        if refused < 0:
            self._play("step", {e: (actions[e].tolist(),) for e in np.flatnonzero(playing).tolist()})
        return refused

    def frame(self, index: int = 0) -> NDArray[np.uint8]:
        """The environment's own picture, where it was built with `pictures`."""
        if not self.can_draw:
            return super().frame(index)
        return np.asarray(self.games.call("frame", {index: ()})[0], np.uint8)

    def close_extras(self, **_: Any) -> None:
        """End the games and their processes; `close` calls it."""
        if hasattr(self, "games"):  # not where the environment could not be built
            self.games.close()

    def _play(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> None:
        for e, outcome in zip(arguments, self.games.call(method, arguments)):
            self.observations[e] = outcome.observations
            self.action_mask[e] = outcome.action_mask
            if outcome.state is not None:
                self.state[e] = outcome.state
            self.rewards[e] = outcome.reward
            self.agent_rewards[e] = outcome.agent_rewards
            self.terminated[e] = outcome.terminated
            self.truncated[e] = outcome.truncated
            if outcome.terminated or outcome.truncated:
                for name in {**self.statistics, **outcome.statistics}:
                    values = self.statistics.setdefault(name, np.full(self.num_envs, np.nan, np.float32))
                    values[e] = outcome.statistics.get(name, math.nan)
            if len(self._sides) > 1:
                self._look_at_sides(self.agent_rewards[e])
            if self._images is not None and e == 0:
                self._look_at_images(outcome)

    def _look_at_images(self, outcome: Outcome) -> None:
        """Warn, after the first episode, where images have so small numbers that these must be codes."""
        self._brightest = max(self._brightest, round(255 * float(outcome.observations[self._images].max()), 2))
        if not outcome.terminated and not outcome.truncated:
            return
        self._images = None
        if 0 < self._brightest <= CODES:
            warn(
                f"{self.name}: its images are declared to have values up to 255, and in an episode none is above "
                f"{self._brightest:.0f}. If these are codes, and not brightness, little is left of them when they are "
                "divided by 255; `no_divide_images` leaves them."
            )

    def _look_at_sides(self, rewards: NDArray[np.float32]) -> None:
        """Warn, once, where agents with other names earn something else, so that their sum may be of no use."""
        earned = [sorted(set(rewards[side].tolist())) for side in self._sides]
        if all(each == earned[0] for each in earned):
            return
        words = " and ".join(self.agent_names[side[0]] for side in self._sides)
        self._sides = []
        warn(
            f"{self.name}: {words} do not earn the same, and the team's reward is the sum over all agents. If they "
            "oppose each other, give the environment an attribute `teams`, the number of each agent's team, such as "
            "{'red_0': 0, 'blue_0': 1} (docs/how-to/use-pettingzoo-or-gymnasium.md)."
        )


def warn(text: str) -> None:
    """A warning. Raises InputError where the user, or a game, has made errors of warnings."""
    try:
        warnings.warn(text, stacklevel=3)
    except UserWarning:
        raise InputError(text) from None


def kind_of(name: str) -> str:
    """What an agent's name says of its kind or side: all but its number."""
    return name.rstrip("0123456789").rstrip("_-. ")
