"""Checks an environment against the contract in `envs.vector`, and says in words what is wrong.

python -m envs check <name>
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.vector import INFO_ARRAYS, VectorEnv

Make = Callable[[int, int, bool], VectorEnv]  # of num_envs, seed and copy
Step = tuple[Any, ...]  # observations, rewards, terminated, truncated, info

EPISODES = 3


def problems(make: Make) -> list[str]:
    """Sentences about what breaks the contract, in the order of the checks; none if nothing does."""
    found: list[str] = []
    for check in (arrays, copies, ends, refusals, randomness, masked_resets):
        for sentence in check(make):
            if sentence not in found:
                found.append(sentence)
        if found:  # what is wrong there would only come up again, and confuse
            break
    return found


def allowed_actions(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """Any of the allowed actions for each agent: [agent, action] -> [agent]."""
    return np.where(mask, rng.random(mask.shape), -1).argmax(axis=1)


def play(env: VectorEnv, episode: int, seed: int | None = None, restart: int | None = None) -> list[Step]:
    """An episode of each sub-environment. A reset counts as a step without rewards and flags.

    The actions of sub-environment i depend on (i, episode) alone. seed: of the reset. restart: before this step
    sub-environment 1 is reset alone.
    """
    generators = [np.random.default_rng([i, episode]) for i in range(env.num_envs)]
    observations, info = env.reset(seed=seed)
    no_flags = np.zeros(env.num_envs, np.bool_)
    steps: list[Step] = [(observations, no_flags.astype(np.float32), no_flags, no_flags, info)]
    for t in range(env.episode_limit):
        masks = steps[-1][-1]["action_mask"]
        if t == restart:
            masks = env.reset(options={"reset_mask": np.arange(env.num_envs) == 1})[1]["action_mask"]
        if not masks.any(axis=2).all():  # nobody can go on; `arrays` says so
            break
        steps.append(env.step(np.stack([allowed_actions(mask, rng) for mask, rng in zip(masks, generators)])))
        if (steps[-1][2] | steps[-1][3]).all():
            break
    return steps


def differ(step: Step, other: Step, index: int) -> bool:
    """Whether a sub-environment differs in any bit."""
    values, others = ([*each[:4], *(each[4][name] for name in INFO_ARRAYS)] for each in (step, other))
    return any(not np.array_equal(x[index], y[index]) for x, y in zip(values, others))


def arrays(make: Make) -> Iterator[str]:
    """Shapes, types and values."""
    env = make(3, 0, True)
    n, n_agents = env.num_envs, env.n_agents
    expected: dict[str, tuple[tuple[int, ...], type]] = {
        "observations": ((n, n_agents, env.obs_size), np.float32),
        "rewards": ((n,), np.float32),
        "terminated": ((n,), np.bool_),
        "truncated": ((n,), np.bool_),
        "agent_rewards": ((n, n_agents), np.float32),
        "state": ((n, env.state_size), np.float32),
        "action_mask": ((n, n_agents, env.n_actions), np.bool_),
    }
    if len(env.teams) != n_agents or set(env.teams) != set(range(max(env.teams) + 1)):
        yield f"env.teams must number the team of each of the {n_agents} agents, from 0 on; it is {env.teams}."
    for step in (step for episode in range(EPISODES) for step in play(env, episode)):
        info = step[4]
        missing = {*INFO_ARRAYS, "statistics"} - info.keys()
        if missing:
            yield f"The info lacks {', '.join(sorted(missing))}."
            return
        found = dict(zip(expected, (*step[:4], *(info[name] for name in INFO_ARRAYS))))
        for name, (shape, kind) in expected.items():
            if found[name].shape != shape or found[name].dtype != kind:
                has = f"{found[name].dtype} {found[name].shape}"
                yield f"{name} must be {np.dtype(kind).name} {shape}; the environment has {has}."
                return
            if not np.isfinite(found[name]).all():
                yield f"{name} has a value that is not a finite number."
        if not env.observation_space.contains(found["observations"]):
            yield "An observation lies outside the bounds `low` and `high` that the environment gives."
        if (found["terminated"] & found["truncated"]).any():
            yield "A sub-environment is terminated and truncated at once; an end must be one of the two."
        if not found["action_mask"].any(axis=2).all():
            yield "The action mask forbids an agent all actions; one at least must be allowed."
        for name, values in info["statistics"].items():
            if np.shape(values) != (n,):
                yield f"info['statistics'][{name!r}] must have the shape {(n,)}; it has {np.shape(values)}."


def ends(make: Make) -> Iterator[str]:
    """Episodes end, and what has ended stands still."""
    env = make(3, 0, True)
    for episode in range(EPISODES):
        steps = play(env, episode)
        if not (steps[-1][2] | steps[-1][3]).all():
            limit = f"env.episode_limit = {env.episode_limit} steps"
            yield f"An episode goes on after {limit}; the last one must truncate it."
            return
        for before, after in pairwise(steps):
            for index in np.flatnonzero(before[2] | before[3]):
                if after[1][index] or after[4]["agent_rewards"][index].any():
                    yield "A sub-environment that has finished still earns rewards."
                if after[2][index] != before[2][index] or after[3][index] != before[3][index]:
                    yield "A sub-environment that has finished does not keep its flag up."
                if not np.array_equal(after[0][index], before[0][index]):
                    yield "A sub-environment that has finished goes on; it must stand still until a reset."


def refusals(make: Make) -> Iterator[str]:
    """Actions that do not exist or are forbidden."""
    env = make(2, 0, True)
    last = env.n_agents - 1
    wrong = {"an action that does not exist": (1, last, env.n_actions), "an action below 0": (0, 0, -1)}
    rng = np.random.default_rng(0)
    for kind in (*wrong, "an action that the mask forbids"):
        observations, info = env.reset()
        mask = info["action_mask"]
        actions = np.stack([allowed_actions(each, rng) for each in mask])
        for _ in range(env.episode_limit - 1):
            if kind in wrong or not mask.all():
                break
            observations, _, _, _, info = env.step(actions)
            mask = info["action_mask"]
            actions = np.stack([allowed_actions(each, rng) for each in mask])
        if kind not in wrong and mask.all():
            continue
        index, agent, action = wrong.get(kind) or np.argwhere(~mask)[0].tolist()
        actions[index, agent] = action
        try:
            env.step(actions)
        except ValueError as error:
            if not all(str(number) in str(error) for number in (index, agent, action)):
                yield f"The error for {kind} must name sub-environment, agent and action; it says: {error}"
        else:
            yield f"A step with {kind} must raise ValueError."
            continue
        if not np.array_equal(env.observations, observations):
            yield f"A step with {kind} changes the environment before it raises ValueError."


def randomness(make: Make) -> Iterator[str]:
    """What sub-environment i plays in its k-th episode depends on (seed, i, k) alone."""
    env, again, alone, later = make(3, 7, True), make(3, 7, True), make(1, 7, True), make(3, 7, True)
    later.episode = EPISODES - 1
    for episode in range(EPISODES):
        steps = play(env, episode)
        if any(differ(step, other, i) for step, other in zip(steps, play(again, episode)) for i in range(3)):
            yield "The same seed does not play the same episodes: runs cannot be repeated, nor resumed exactly."
            return
        if any(differ(step, other, 0) for step, other in zip(steps, play(alone, episode))):
            yield "Sub-environment 0 plays something else when there are others beside it."
    seeded = play(make(3, 0, True), 0, seed=7)
    if any(differ(step, other, i) for step, other in zip(play(make(3, 7, True), 0), seeded) for i in range(3)):
        yield "reset(seed=7) does not begin the episodes of an environment that was made with seed 7."
    if any(differ(step, other, i) for step, other in zip(steps, play(later, EPISODES - 1)) for i in range(3)):
        last = EPISODES - 1
        yield (
            f"Episode {last} is another one if those before it were not played (env.episode = {last}, then a reset). "
            "So it does not depend on the seed alone, and a resumed run would differ."
        )


def masked_resets(make: Make) -> Iterator[str]:
    """A reset of some sub-environments leaves the others alone."""
    env = make(3, 0, True)
    before = play(env, 0)[-1]
    observations, info = env.reset(options={"reset_mask": np.array([False, True, False])})
    after = (observations, env.rewards, env.terminated, env.truncated, info)
    if differ(before, after, 0) or differ(before, after, 2):
        yield "A reset with options['reset_mask'] changes sub-environments that the mask does not name."
    if env.terminated[1] or env.truncated[1]:
        yield "A reset with options['reset_mask'] does not take down the flag of a sub-environment that it names."
    whole = play(make(3, 0, True), 0)
    ended = [next(t for t, step in enumerate(whole) if step[2][i] | step[3][i]) for i in (0, 2)]
    again = play(make(3, 0, True), 0, restart=min(ended) // 2)
    if any(differ(step, other, i) for step, other in zip(whole, again) for i in (0, 2)):
        yield "A reset with options['reset_mask'] in the middle changes sub-environments that the mask does not name."


def copies(make: Make) -> Iterator[str]:
    """With copy=True the caller may keep what it got; with copy=False it gets the same arrays each time."""
    kept, shared = play(make(2, 0, True), 0), make(2, 0, False)
    if any(np.shares_memory(kept[0][0], step[0]) for step in kept[1:]):
        yield "With copy=True, a step writes into the arrays that an earlier one returned."
    if play(shared, 0)[-1][0] is not shared.observations:
        yield "With copy=False, a step must return the environment's own arrays."
