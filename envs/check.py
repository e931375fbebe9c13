"""Checks an environment against the contract in `envs.vector`, and says in words what is wrong.

python -m envs check <name>
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.vector import INFO_ARRAYS, RESULTS, InputError, VectorEnv

Make = Callable[[int, int, bool], VectorEnv]  # of num_envs, seed and copy
Step = tuple[Any, ...]  # observations, rewards, terminated, truncated, info
Masks = NDArray[np.bool_]  # [env, agent, action]

EPISODES = 3


def problems(make: Make) -> list[str]:
    """Sentences about what breaks the contract, in the order of the checks; none if nothing does.

    Raises InputError for what cannot be built at all.
    """
    found: list[str] = []
    make(1, 0, True).close()
    for check in (arrays, copies, ends, randomness, refusals, masked_resets):
        try:
            for sentence in check(make):
                if sentence not in found:
                    found.append(sentence)
        except InputError as error:  # a sentence already
            found.append(str(error))
        except Exception as error:  # an assertion of the game, for example
            found.append(failure(error, check.__doc__ or ""))
        if found:  # what is wrong there would only come up again, and confuse
            break
    return found


def failure(error: Exception, topic: str) -> str:
    """A sentence about an error of the environment's own, met while a topic was looked at."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    lines = f"{type(error).__name__}: {error}".split("\n")  # of a worker process: with its traceback in the middle
    said = " ".join(dict.fromkeys((lines[0], lines[-1]))).rstrip(": .")
    where = f"{Path(place.filename).name}, line {place.lineno}"
    return f"The environment fails ({where}) with {said}. What was looked at: {topic[0].lower()}{topic[1:]}"


def allowed_actions(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """Any of the allowed actions for each agent: [agent, action] -> [agent]."""
    return np.where(mask, rng.random(mask.shape), -1).argmax(axis=1)


def play(
    env: VectorEnv,
    episode: int,
    seed: int | None = None,
    before: Callable[[int, Masks], Masks] = lambda t, masks: masks,
) -> list[Step]:
    """An episode of each sub-environment. A reset counts as a step without rewards and flags.

    The actions of sub-environment i depend on (i, episode) alone. seed: of the reset. before: is called before step t,
    from 0 on, with the action masks, and returns those to go on with.
    """
    generators = [np.random.default_rng([i, episode]) for i in range(env.num_envs)]
    observations, info = env.reset(seed=seed)
    no_flags = np.zeros(env.num_envs, np.bool_)
    steps: list[Step] = [(observations, no_flags.astype(np.float32), no_flags, no_flags, info)]
    for t in range(env.episode_limit):
        masks = before(t, steps[-1][-1]["action_mask"])
        if not masks.any(axis=2).all():  # nobody can go on; `arrays` says so
            break
        steps.append(env.step(np.stack([allowed_actions(mask, rng) for mask, rng in zip(masks, generators)])))
        if (steps[-1][2] | steps[-1][3]).all():
            break
    return steps


def named(step: Step) -> dict[str, Any]:
    """All arrays of a step by name; that of a statistic is `info['statistics'][its name]`."""
    info = step[4]
    statistics = {f"info['statistics'][{name!r}]": values for name, values in info["statistics"].items()}
    return dict(zip(RESULTS, step)) | {name: info[name] for name in INFO_ARRAYS} | statistics


def differences(step: Step, other: Step, index: int) -> list[str]:
    """The names of the arrays in which a sub-environment differs in any bit.

    Statistics count where an episode has ended; they may be NaN.
    """
    values, others = named(step), named(other)
    ended = step[2][index] | step[3][index]
    counted = [name for name in values if ended or "statistics" not in name]
    return [
        name
        for name in counted
        if not np.array_equal(values[name][index], others[name][index], equal_nan="statistics" in name)
    ]


def differ(steps: list[Step], others: list[Step], index: int) -> bool:
    """Whether a sub-environment plays another episode."""
    return any(differences(step, other, index) for step, other in zip(steps, others))


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
    lacking = np.arange(env.n_actions) >= np.array(env.choices)[:, None]  # [agent, action]
    if len(env.teams) != n_agents or set(env.teams) != set(range(max(env.teams) + 1)):
        yield f"env.teams must number the team of each of the {n_agents} agents, from 0 on; it is {env.teams}."
    for step in (step for episode in range(EPISODES) for step in play(env, episode)):
        info = step[4]
        missing = {*INFO_ARRAYS, "statistics"} - info.keys()
        if missing:
            yield f"The info lacks {', '.join(sorted(missing))}."
            return
        found = named(step)
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
        if (found["action_mask"] & lacking).any():
            yield f"The action mask allows an agent actions that it does not have: env.choices is {env.choices}."
        for name, values in info["statistics"].items():
            if not isinstance(values, np.ndarray) or values.shape != (n,):
                has = f"{type(values).__name__} {np.shape(values)}"
                yield f"info['statistics'][{name!r}] must be an array of the shape {(n,)}; it is {has}."


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
            for index in np.flatnonzero(before[2] | before[3]).tolist():
                if after[1][index] or after[4]["agent_rewards"][index].any():
                    yield "A sub-environment that has finished still earns rewards."
                changed = set(differences(before, after, index)) - {"rewards", "agent_rewards"}
                if changed & {"terminated", "truncated"}:
                    yield "A sub-environment that has finished does not keep its flag up."
                elif changed:
                    names = ", ".join(sorted(changed))
                    yield f"A sub-environment that has finished goes on ({names}); it must stand still until a reset."


def randomness(make: Make) -> Iterator[str]:
    """What sub-environment i plays in its k-th episode depends on (seed, i, k) alone."""
    env, again, alone, later = make(3, 7, True), make(3, 7, True), make(1, 7, True), make(3, 7, True)
    later.episode = EPISODES - 1
    for episode in range(EPISODES):
        steps = play(env, episode)
        repeated = play(again, episode)
        if any(differ(steps, repeated, i) for i in range(3)):
            yield "The same seed does not play the same episodes: runs cannot be repeated, nor resumed exactly."
            return
        if differ(steps, play(alone, episode), 0):
            yield "Sub-environment 0 plays something else when there are others beside it."
    made, seeded = play(make(3, 7, True), 0), play(make(3, 0, True), 0, seed=7)
    if any(differ(made, seeded, i) for i in range(3)):
        yield "reset(seed=7) does not begin the episodes of an environment that was made with seed 7."
    last = EPISODES - 1
    skipped = play(later, last)
    if any(differ(steps, skipped, i) for i in range(3)):
        yield (
            f"Episode {last} is another one if those before it were not played (env.episode = {last}, then a reset). "
            "So it does not depend on the seed alone, and a resumed run would differ."
        )


def refusals(make: Make) -> Iterator[str]:
    """Actions that do not exist or are forbidden."""
    whole = play(make(2, 0, True), 0)
    n_agents, n_actions = whole[0][4]["action_mask"].shape[1:]
    wrong = {  # before which step, and of which sub-environment and agent
        "an action that does not exist": (0, 1, n_agents - 1, n_actions),
        "an action below 0": (0, 0, 0, -1),
    }
    forbidden = ((t, *place) for t, step in enumerate(whole[:-1]) for place in np.argwhere(~step[4]["action_mask"]))
    for t, index, agent, action in forbidden:
        wrong["an action that the mask forbids"] = (t, int(index), int(agent), int(action))
        break
    for kind, place in wrong.items():
        env, errors = make(2, 0, True), list[str]()
        again = play(env, 0, before=partial(attempt, env, place, errors))
        if not errors:
            yield f"A step with {kind} must raise ValueError."
            continue
        if not all(str(number) in errors[0] for number in place[1:]):
            yield f"The error for {kind} must name sub-environment, agent and action; it says: {errors[0]}"
        if errors[1:] or any(differ(whole, again, index) for index in range(2)):
            what = ", ".join(errors[1:]) or "what its next steps show"
            yield f"A step with {kind} changes the environment before it raises ValueError ({what})."


def attempt(env: VectorEnv, place: tuple[int, int, int, int], errors: list[str], t: int, masks: Masks) -> Masks:
    """Before one step of an episode, tries an action that must be refused.

    place: step, sub-environment, agent and action. errors: gets the error's text, and then the names of the arrays
    that the attempt has changed. See `play` for the others.
    """
    when, index, agent, action = place
    if t == when:
        actions = masks.argmax(axis=2)
        actions[index, agent] = action
        before = [(name, getattr(env, name).copy()) for name in (*RESULTS, *INFO_ARRAYS)]
        try:
            env.step(actions)
        except ValueError as error:
            errors.append(str(error))
            errors += [name for name, values in before if not np.array_equal(values, getattr(env, name))]
    return masks


def masked_resets(make: Make) -> Iterator[str]:
    """A reset of some sub-environments leaves the others alone."""
    env = make(3, 0, True)
    before = play(env, 0)[-1]
    observations, info = env.reset(options={"reset_mask": np.array([False, True, False])})
    after = (observations, env.rewards, env.terminated, env.truncated, info)
    if differences(before, after, 0) or differences(before, after, 2):
        yield "A reset with options['reset_mask'] changes sub-environments that the mask does not name."
    if env.terminated[1] or env.truncated[1]:
        yield "A reset with options['reset_mask'] does not take down the flag of a sub-environment that it names."
    whole = play(make(3, 0, True), 0)
    ended = [next(t for t, step in enumerate(whole) if step[2][i] | step[3][i]) for i in (0, 2)]
    env = make(3, 0, True)
    again = play(env, 0, before=partial(restart, env, min(ended) // 2))
    if differ(whole, again, 0) or differ(whole, again, 2):
        yield "A reset with options['reset_mask'] in the middle changes sub-environments that the mask does not name."


def restart(env: VectorEnv, when: int, t: int, masks: Masks) -> Masks:
    """Before step `when` of an episode, resets sub-environment 1 alone. See `play` for the others."""
    if t == when:
        masks = env.reset(options={"reset_mask": np.arange(env.num_envs) == 1})[1]["action_mask"]
    return masks


def copies(make: Make) -> Iterator[str]:
    """With copy=True the caller may keep what it got; with copy=False it gets the same arrays each time."""
    env, shared = make(2, 0, True), make(2, 0, False)
    kept = [named(step) for episode in range(2) for step in play(env, episode)]
    for name in kept[0]:
        if len({step[name].__array_interface__["data"][0] for step in kept}) < len(kept):
            yield f"With copy=True, a step writes into the arrays that an earlier one returned ({name})."
    if play(shared, 0)[-1][0] is not shared.observations:
        yield "With copy=False, a step must return the environment's own arrays."
