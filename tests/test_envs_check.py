"""The check of the contract: every family keeps it, and each way of breaking it is named."""

from __future__ import annotations

import random
import sys
import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import programs
import pytest
import torch
from scripts import ROOT, load_module, script, trained

import envs
from envs import runs
from envs.check import hints, problems
from envs.vector import VectorEnv, forbidden_action

meeting_numpy: Any = load_module(ROOT / "examples" / "meeting_numpy.py")
meeting_compiled: Any = load_module(ROOT / "examples" / "meeting_compiled.py")
meeting_pettingzoo: Any = load_module(ROOT / "examples" / "meeting_pettingzoo.py")

EXAMPLES = ["own:examples.meeting_numpy", "own:examples.meeting_compiled", "pettingzoo:examples.meeting_pettingzoo"]
TASKS = [
    "matrix-climbing",
    "lbf-6x6-2p-2f",
    "lbf-5x5-4p-1f-c",  # the food's level is above every coordinate
    "rware-tiny-2p",
    "mpe-speaker-listener",
    "mpe2-tag-selfplay",
    "smaclite-3m",
]


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


@pytest.mark.parametrize("name", [*TASKS, *EXAMPLES])
def test_nothing_is_wrong(name: str) -> None:
    assert problems(lambda num_envs, seed, copy: envs.make(name, num_envs, seed, copy)) == []


# ---------------------------------------------------------------------------------------------------------------------
# Environments that break the contract, each in one way
# ---------------------------------------------------------------------------------------------------------------------


class Meeting(meeting_numpy.Env):
    """The example, to be broken."""

    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__("meeting", num_envs, seed, copy)


class NotFinite(Meeting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.rewards[e] = np.inf


class OutOfBounds(Meeting):
    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, rng)
        self.observations[e, 0, 0] = -1


class BothFlags(Meeting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.truncated[e] |= self.terminated[e]


class NoAction(Meeting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.action_mask[e, 1] = False
        self.terminated[e] = True


class NumberedTeams(Meeting):
    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.teams = (1, 2)


class OtherType(Meeting):
    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.agent_rewards = np.zeros((num_envs, 2))
        self._connect()


class OddStatistics(Meeting):
    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.statistics["steps"] = np.zeros((num_envs, 1), np.float32)


class NeverEnds(Meeting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.terminated[e] = self.truncated[e] = False


class MovesOn(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        refused = super().step_envs(actions, playing)
        if refused < 0:
            self.observations[~playing] = CELLS - 1 - self.observations[~playing]
        return refused


class LowersFlags(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        self.terminated[~playing] = False
        self.truncated[~playing] = True
        return super().step_envs(actions, playing)


class TakesAnything(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        return super().step_envs(np.clip(actions, 0, 2), playing)


class MovesFirst(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        if forbidden_action(actions, self.action_mask) >= 0:
            self.observations[:] = 0
        return super().step_envs(actions, playing)


class NoSeed(Meeting):
    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, np.random.default_rng())


class NoSeedLast(Meeting):
    """Right but for the last sub-environment, as the next two."""

    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, np.random.default_rng() if e == 2 else rng)


class CountsLast(Meeting):
    count = 0

    def reset_env(self, e: int, rng: Any) -> None:
        self.count += e == 2
        super().reset_env(e, np.random.default_rng(self.count) if e == 2 else rng)


class ResetsLast(Meeting):
    def reset_envs(self, mask: Any, seed: Any, episodes: Any) -> None:
        super().reset_envs(mask | (np.arange(self.num_envs) == 2), seed, episodes)


class SharedClock(Meeting):
    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, rng)
        self.steps[:] = 0

    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.terminated[e], self.truncated[e] = False, self.steps[e] == self.episode_limit


class KeepsSeed(Meeting):
    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.first_seed = np.uint64(seed)

    def reset_envs(self, mask: Any, seed: Any, episodes: Any) -> None:
        super().reset_envs(mask, self.first_seed, episodes)


class ForbidsLater(Meeting):
    """Forbids waiting after the first step, but accepts it."""

    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, rng)
        self.action_mask[e] = True

    def step_envs(self, actions: Any, playing: Any) -> int:
        self.action_mask[:] = True
        refused = super().step_envs(actions, playing)
        self.action_mask[:, :, 0] = refused >= 0
        return refused


class EarnsOn(Meeting):
    def _outcome(self) -> Any:
        self.agent_rewards[~self._playing] = 1
        return super()._outcome()


class KeepsFlags(Meeting):
    def reset_envs(self, mask: Any, seed: Any, episodes: Any) -> None:
        super().reset_envs(mask, seed, episodes)
        self.terminated[mask] = 0 < mask.sum() < self.num_envs


class VagueError(Meeting):
    def step(self, actions: Any) -> Any:
        try:
            return super().step(actions)
        except ValueError:
            raise ValueError("a wrong action") from None


class NoStatistics(Meeting):
    def _outcome(self) -> Any:
        *arrays, info = super()._outcome()
        return (*arrays, {name: value for name, value in info.items() if name != "statistics"})


class CopiesAlways(Meeting):
    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, True)


class OneGenerator(Meeting):
    """All sub-environments draw from the same generator."""

    def reset_envs(self, mask: Any, seed: Any, episodes: Any) -> None:
        rng = np.random.default_rng([int(seed), int(episodes[0]), self.num_envs])
        for e in np.flatnonzero(mask).tolist():
            self.reset_env(e, rng)


class CountsItself(Meeting):
    """Counts its episodes, which a resumed run does not know."""

    count = 0

    def reset_env(self, e: int, rng: Any) -> None:
        self.count += e == 0
        super().reset_env(e, np.random.default_rng([e, self.count]))


class ResetsAll(Meeting):
    def reset_envs(self, mask: Any, seed: Any, episodes: Any) -> None:
        super().reset_envs(np.ones_like(mask), seed, episodes)


class NoCopies(Meeting):
    def _outcome(self) -> Any:
        return (*self._returned, self.info)


class OtherArrays(Meeting):
    """Makes a new array in each step, while callers hold the first one."""

    def step_envs(self, actions: Any, playing: Any) -> int:
        refused = super().step_envs(actions, playing)
        self.rewards: Any = np.array(self.rewards)
        return refused


class AllowsTooMuch(Meeting):
    """Agent 1 has two of the three actions."""

    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.choices = (3, 2)


class RewardsFirst(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        self.rewards[:] = 1
        return super().step_envs(actions, playing)


class CountsFirst(Meeting):
    """The clock goes on, which is seen at the end of the episode only."""

    def step_envs(self, actions: Any, playing: Any) -> int:
        self.steps += forbidden_action(actions, self.action_mask) >= 0
        return super().step_envs(actions, playing)


class ChangesMaskLater(Meeting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        refused = super().step_envs(actions, playing)
        self.action_mask[~playing, :, 0] ^= refused < 0
        return refused


class Counting(Meeting):
    """With a statistic."""

    def __init__(self, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(num_envs, seed, copy)
        self.statistics["steps"] = np.zeros(num_envs, np.float32)

    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, rng)
        self.statistics["steps"][e] = 0

    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.statistics["steps"][e] += 1


class CountsOn(Counting):
    def step_envs(self, actions: Any, playing: Any) -> int:
        refused = super().step_envs(actions, playing)
        self.statistics["steps"][~playing] += refused < 0
        return refused


class GuessesStatistics(Counting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.statistics["steps"][e] = np.random.default_rng().random()


class LiveStep(Meeting):
    """What `reset` returns is a copy, what `step` returns is not."""

    def step(self, actions: Any) -> Any:
        return (self.observations, *super().step(actions)[1:])


class LiveInfo(Meeting):
    def _outcome(self) -> Any:
        *arrays, info = super()._outcome()
        return (*arrays, info | {"action_mask": self.action_mask})


class LiveStatistics(Counting):
    def _outcome(self) -> Any:
        *arrays, info = super()._outcome()
        return (*arrays, info | {"statistics": self.statistics})


class Asserts(Meeting):
    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        assert self.steps[e] < 3, "nobody plays so long"
        super().step_env(e, actions, rng)


class LooksUpFirst(Meeting):
    """An action that does not exist ends in an error of NumPy."""

    def step_envs(self, actions: Any, playing: Any) -> int:
        meeting_numpy.MOVES[actions]
        return super().step_envs(actions, playing)


class UnknownStatistic(Counting):
    """Nothing is wrong: a statistic may be no number."""

    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        super().step_env(e, actions, rng)
        self.statistics["steps"][e] = np.nan


class ChangingMask(Meeting):
    """Nothing is wrong: what is forbidden depends on the episode."""

    def reset_env(self, e: int, rng: Any) -> None:
        super().reset_env(e, rng)
        self.action_mask[e] = True
        self.action_mask[e, :, 1] = rng.random() < 0.5


@pytest.mark.parametrize("right", [ChangingMask, Counting, UnknownStatistic])
def test_what_looks_wrong_and_is_not(right: type[VectorEnv]) -> None:
    assert problems(right) == []


@pytest.mark.parametrize("copy", [True, False])
def test_other_arrays_are_named(copy: bool) -> None:
    """Scripts do not copy: they would see a reward of 0 for ever, or an episode without an end."""
    env = OtherArrays(2, 0, copy)
    env.reset()
    with pytest.raises(envs.InputError, match=r"self\.rewards is another array than at the start"):
        for _ in range(env.episode_limit):
            env.step(np.zeros((2, 2), int))


CELLS = meeting_numpy.CELLS


@pytest.mark.parametrize(
    ("broken", "sentence"),
    [
        (NotFinite, "rewards has a value that is not a finite number."),
        (OutOfBounds, "An observation lies outside the bounds"),
        (BothFlags, "terminated and truncated at once"),
        (NoAction, "The action mask forbids an agent all actions"),
        (NumberedTeams, "env.teams must number the team of each of the 2 agents"),
        (OtherType, "agent_rewards must be float32 (3, 2); the environment has float64 (3, 2)."),
        (OddStatistics, "info['statistics']['steps'] must be an array of the shape (3,); it is ndarray (3, 1)."),
        (NeverEnds, "An episode goes on after env.episode_limit = 20 steps"),
        (MovesOn, "A sub-environment that has finished goes on"),
        (LowersFlags, "does not keep its flag up"),
        (TakesAnything, "A step with an action that does not exist must raise ValueError."),
        (MovesFirst, "A step with an action that does not exist changes the environment"),
        (NoSeed, "The same seed does not play the same episodes"),
        (NoSeedLast, "The same seed does not play the same episodes"),
        (CountsLast, "Episode 2 is another one if those before it were not played"),
        (ResetsLast, "changes sub-environments that the mask does not name"),
        (SharedClock, "in the middle changes sub-environments that the mask does not name"),
        (KeepsSeed, "reset(seed=7) does not begin the episodes of an environment that was made with seed 7."),
        (ForbidsLater, "A step with an action that the mask forbids must raise ValueError."),
        (EarnsOn, "A sub-environment that has finished still earns rewards."),
        (KeepsFlags, "does not take down the flag of a sub-environment that it names"),
        (VagueError, "must name sub-environment, agent and action; it says: a wrong action"),
        (NoStatistics, "The info lacks statistics."),
        (CopiesAlways, "With copy=False, a step must return the environment's own arrays."),
        (OneGenerator, "Sub-environment 0 plays something else when there are others beside it."),
        (CountsItself, "Episode 2 is another one if those before it were not played"),
        (ResetsAll, "changes sub-environments that the mask does not name"),
        (NoCopies, "With copy=True, a step writes into the arrays that an earlier one returned (observations)."),
        (LiveStep, "a step writes into the arrays that an earlier one returned (observations)."),
        (LiveInfo, "a step writes into the arrays that an earlier one returned (action_mask)."),
        (LiveStatistics, "an earlier one returned (info['statistics']['steps'])."),
        (AllowsTooMuch, "allows an agent actions that it does not have: env.choices is (3, 2)."),
        (RewardsFirst, "does not exist changes the environment before it raises ValueError (rewards)."),
        (CountsFirst, "changes the environment before it raises ValueError (what its next steps show)."),
        (ChangesMaskLater, "A sub-environment that has finished goes on (action_mask)"),
        (CountsOn, "A sub-environment that has finished goes on (info['statistics']['steps'])"),
        (GuessesStatistics, "The same seed does not play the same episodes"),
        (Asserts, ") with AssertionError: nobody plays so long"),
        (LooksUpFirst, "with IndexError: index 3 is out of bounds"),
    ],
)
def test_what_is_wrong_is_named(broken: type[VectorEnv], sentence: str) -> None:
    found = problems(broken)
    assert found and sentence in found[0], found


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["lbf-6x6-2p-2f"], 0, "lbf-6x6-2p-2f keeps the contract."),
        (
            ["gymnasium:lbforaging:Foraging-5x5-2p-1f-v3"],
            1,
            "a resumed run would differ",
        ),  # see foreign.py
        (
            ["pettingzoo:mpe2.simple_spread_v3", "--env-kwargs", "N=2", "--max-episode-steps", "5"],
            0,
            "keeps the contract",
        ),
        (["lbf-6x6"], 2, "unknown task"),
    ],
)
@pytest.mark.slow
def test_the_program(flags: list[str], code: int, says: str) -> None:
    done = programs.run([sys.executable, "-m", "envs", "check", *flags])
    assert done.returncode == code and says in done.stdout + done.stderr, done.stderr


def test_what_an_adapter_finds_while_it_plays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is a finding like others; only what cannot be built is an error."""
    (tmp_path / "toy_odd_too.py").write_text("from toys import Odd as parallel_env\n")
    monkeypatch.chdir(tmp_path)

    def make(num_envs: int, seed: int, copy: bool, kind: str = "blind") -> VectorEnv:
        return envs.make("pettingzoo:toy_odd_too", num_envs, seed, copy, env_kwargs={"kind": kind})

    assert problems(make) == ["pettingzoo:toy_odd_too: the agents ['b'] play on without an observation."]
    with pytest.raises(envs.InputError, match="need discrete ones"):
        problems(lambda num_envs, seed, copy: make(num_envs, seed, copy, "continuous"))


@pytest.fixture
def toys_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Modules of toys in the current folder."""
    for name in ("Reseeds", "Painted", "Sides"):
        (tmp_path / f"a_toy_{name.lower()}.py").write_text(f"from toys import {name} as parallel_env\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("when", ["made", "reset", "step"])
@pytest.mark.parametrize("what", ["random", "numpy", "torch"])
def test_a_game_that_seeds_what_all_share(toys_here: None, what: str, when: str) -> None:
    """It is said, and the check itself leaves these generators alone."""
    before = random.getstate(), np.random.get_state()[1].tolist(), torch.get_rng_state()  # type: ignore[index]
    (found,) = problems(
        lambda num_envs, seed, copy: envs.make(
            "pettingzoo:a_toy_reseeds", num_envs, seed, copy, env_kwargs={"what": what, "when": when}
        )
    ) or [""]
    call = {"random": "random.seed", "numpy": "numpy.random.seed", "torch": "torch.manual_seed"}[what]
    moment = {"made": "it is made", "reset": "an episode begins", "step": "it makes a step"}[when]
    assert f"The environment calls {call}, " in found and moment in found
    if what != "random":
        assert random.getstate() == before[0]
    if what != "numpy":
        assert np.random.get_state()[1].tolist() == before[1]  # type: ignore[index]
    if what != "torch":
        assert torch.equal(torch.get_rng_state(), before[2])


@pytest.mark.slow
def test_hints(toys_here: None) -> None:
    """What makes learning hard and breaks no rule."""

    def hints_for(name: str, **options: Any) -> list[str]:
        return hints(lambda num_envs, seed, copy: envs.make(name, num_envs, seed, copy, **options))

    assert hints_for("lbf-15x15-3p-5f") == hints_for("mpe-spread") == []
    assert hints_for("pettingzoo:a_toy_painted", flatten_images=True) == []
    (far,) = hints_for("pettingzoo:a_toy_painted", env_kwargs={"kind": "high vector"})
    assert far.startswith("Observations reach 1,000.")
    (sides,) = hints_for("pettingzoo:a_toy_sides")
    assert "red_0 and blue_0 do not earn the same" in sides


class Wide(VectorEnv):
    """Large observations; an episode lasts as long as the name says."""

    def __init__(self, steps: int, num_envs: int, seed: int, copy: bool) -> None:
        sizes = {"n_agents": 1, "n_actions": 2, "obs_size": 50_000, "episode_limit": steps}
        super().__init__("wide", num_envs, seed, copy, low=0, high=1, **sizes)  # type: ignore[arg-type]
        self.steps = np.zeros(num_envs, np.int64)

    def reset_env(self, e: int, rng: Any) -> None:
        self.steps[e] = 0
        self.observations[e] = rng.random()

    def step_env(self, e: int, actions: Any, rng: Any) -> None:
        self.steps[e] += 1
        self.truncated[e] = self.steps[e] == self.episode_limit


def test_no_episode_is_kept_as_a_whole() -> None:
    """Longer episodes take no more memory."""
    peaks = []
    for steps in (10, 60):
        tracemalloc.start()
        assert problems(partial(Wide, steps)) == []
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0], peaks


# ---------------------------------------------------------------------------------------------------------------------
# The example, written three times
# ---------------------------------------------------------------------------------------------------------------------


def test_the_three_examples_play_the_same_game() -> None:
    plain = meeting_numpy.Env("plain", 1, 0, True)
    compiled = meeting_compiled.Env("compiled", 1, 0, True)
    parallel = meeting_pettingzoo.Meeting()
    rng = np.random.default_rng(0)
    met = late = 0
    for episode in range(60):
        plain.reset()
        compiled.reset()
        parallel.reset(seed=episode)
        plain.cell[0] = compiled.cell[0] = parallel.cell
        done = False
        while not done:
            action = rng.integers(0, 3, (1, 2)) if episode % 2 else np.array([[1, 2]])  # or: away from each other
            results = [env.step(action) for env in (plain, compiled)]
            views, rewards, ends, time_outs, _ = parallel.step({"anna": action[0, 0], "ben": action[0, 1]})
            for observations, reward, terminated, truncated, info in results:
                np.testing.assert_array_equal(observations[0], [views["anna"], views["ben"]])
                np.testing.assert_allclose(info["agent_rewards"][0], [rewards["anna"], rewards["ben"]], rtol=1e-6)
                assert reward[0] == pytest.approx(sum(rewards.values()))
                assert (terminated[0], truncated[0]) == (ends["anna"], time_outs["ben"])
            done = ends["anna"] or time_outs["anna"]
        met += ends["anna"]
        late += time_outs["anna"]
    assert met > 20 and late > 5


def test_starts_are_two_cells() -> None:
    """All pairs of different cells, in the plain and in the compiled rules."""
    for module in (meeting_numpy, meeting_compiled):
        env = module.Env("meeting", 2000, 0, True)
        env.reset()
        pairs = {tuple(pair) for pair in env.cell.tolist()}
        assert pairs == {(a, b) for a in range(CELLS) for b in range(CELLS) if a != b}


def test_an_own_module_may_have_any_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even the name of the module that holds the adapters."""
    monkeypatch.setitem(sys.modules, "foreign", meeting_numpy)
    assert isinstance(envs.make("own:foreign", 2), meeting_numpy.Env)


@pytest.mark.slow
def test_a_team_learns_the_example(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best is 0.9 or so; agents who do not move earn -1."""
    learnt = trained(monkeypatch, "ippo", 250, "own:examples.meeting_numpy", learning_rate=0.001)
    env = envs.make("own:examples.meeting_numpy", 200, seed=9)
    team = script("ippo").Team(learnt.args, learnt.parts["agents"], torch.Generator().manual_seed(0))
    figure = runs.evaluate(env, team, 1)["return_mean"]
    print(f"mean return {figure:.2f}")
    assert figure > 0.8
