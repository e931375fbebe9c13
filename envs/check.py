"""Checks an environment against the contract in `envs.vector`, and says in words what is wrong.

python -m envs check <name>

Episodes are compared while they are played, step by step, so that no episode is kept as a whole.
"""

from __future__ import annotations

import contextlib
import pickle
import random
import sys
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import pairwise, zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.faults import in_words, place
from envs.settings import Settings
from envs.vector import INFO_ARRAYS, RESULTS, InputError, VectorEnv

Make = Callable[[int, int, bool], VectorEnv]  # of num_envs, seed and copy
Step = tuple[Any, ...]  # observations, rewards, terminated, truncated, info
Masks = NDArray[np.bool_]  # [env, agent, action]
Check = Callable[[Make], Iterable[str]]

EPISODES = 3
SETTINGS = {
    "dtype": "PyTorch's type of numbers",
    "gradients": "whether PyTorch makes gradients",
    "device": "PyTorch's device",
    "threads": "PyTorch's threads",
    "folder": "the working directory",
    "errors": "what NumPy does in an overflow",
}
FAR = 20.0  # observations beyond it are far from 1


def problems(make: Make, progress: Callable[[list[Check]], Iterable[Check]] = iter) -> list[str]:
    """Sentences about what breaks the contract, in the order of the checks; none if nothing does.

    progress: is given the list of checks and hands them out, such as a progress bar.
    Raises InputError for what cannot be built at all.
    """
    try:
        make(1, 0, True).close()
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        return [failure(error, "How it is built, and closed.")]
    found: list[str] = []
    before = Settings.now()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `hints` shows them
        for check in progress([arrays, copies, ends, randomness, generators, settings, refusals, masked_resets]):
            try:
                with contextlib.ExitStack() as made:
                    for sentence in check(partial(to_be_closed, make, made)):
                        if sentence not in found:
                            found.append(sentence)
            except InputError as error:  # a sentence already
                found.append(str(error))
            except (Exception, SystemExit) as error:  # an assertion of the game, for example
                found.append(failure(error, check.__doc__ or ""))
            finally:
                before.hold(Settings.now())  # for `settings`, which finds what changes them
            if found:  # what is wrong there would only come up again, and confuse
                break
    return found


def to_be_closed(make: Make, made: contextlib.ExitStack, num_envs: int, seed: int, copy: bool) -> VectorEnv:
    """An environment that is closed at the end of `made`."""
    env = make(num_envs, seed, copy)
    made.callback(env.close)
    return env


def hints(make: Make) -> list[str]:
    """Sentences about what breaks no rule, but makes learning hard; what the environment itself warns of is among them.

    Raises what the environment raises.
    """
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        env = make(1, 0, True)
        largest = max(float(np.abs(step[0]).max(initial=0)) for step in play(env, 0))
        env.close()
    bounds = np.abs([env.single_observation_space.low, env.single_observation_space.high])  # type: ignore[attr-defined]
    finite = bounds[bounds < np.finfo(np.float32).max]
    found = []
    if max(largest, finite.max(initial=0)) > FAR:
        found.append(
            f"Observations reach {max(largest, finite.max(initial=0)):,.0f}. Networks learn best from numbers around "
            "-1 to 1; a wrapper should divide them."
        )
    ours = dict.fromkeys(str(each.message) for each in said if each.category is UserWarning)
    return found + [text for text in ours if env.name in text]


def failure(error: BaseException, topic: str) -> str:
    """A sentence about an error of the environment's own, met while a topic was looked at."""
    lines = in_words(error)
    if "worker process" in lines:  # with its traceback in the middle
        ends = str(error).split("\n")
        lines = f"{type(error).__name__}: {ends[0]} {ends[-1]}"
    said = " ".join(lines.split()).rstrip(": .")
    found = place(error)
    where = f" ({found})" if found else ""
    return f"The environment fails{where} with {said}. What was looked at: {topic[0].lower()}{topic[1:]}"


def allowed_actions(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """Any of the allowed actions for each agent: [agent, action] -> [agent]."""
    return np.where(mask, rng.random(mask.shape), -1).argmax(axis=1)


def play(
    env: VectorEnv,
    episode: int,
    seed: int | None = None,
    before: Callable[[int, Masks], Masks] = lambda t, masks: masks,
) -> Iterator[Step]:
    """The steps of an episode of each sub-environment. A reset is the first one, without rewards and flags.

    The actions of sub-environment i depend on (i, episode) alone. seed: of the reset. before: is called before step t,
    from 0 on, with the action masks, and returns those to go on with.
    """
    generators = [np.random.default_rng([i, episode]) for i in range(env.num_envs)]
    observations, info = env.reset(seed=seed)
    no_flags = np.zeros(env.num_envs, np.bool_)
    step: Step = (observations, no_flags.astype(np.float32), no_flags, no_flags, info)
    yield step
    for t in range(env.episode_limit):
        masks = before(t, step[-1]["action_mask"])
        if not masks.any(axis=2).all():  # nobody can go on; `arrays` says so
            return
        step = env.step(np.stack([allowed_actions(mask, rng) for mask, rng in zip(masks, generators)]))
        yield step
        if (step[2] | step[3]).all():
            return


def last_of(steps: Iterator[Step]) -> Step:
    """Play on to the last step, which is returned."""
    return deque(steps, maxlen=1)[0]


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
    none = np.full(len(step[2]), np.nan)  # a statistic that another environment has not met yet
    return [
        name
        for name in {**values, **others}
        if (ended or "statistics" not in name)
        and not np.array_equal(
            values.get(name, none)[index], others.get(name, none)[index], equal_nan="statistics" in name
        )
    ]


def differing(episode: Iterator[Step], *others: Iterator[Step], indices: Iterable[int]) -> set[int]:
    """Which of the other episodes, by number, are played in another way by one of these sub-environments."""
    return {
        number
        for step, *rest in zip_longest(episode, *others)
        for number, other in enumerate(rest)
        if step and other and any(differences(step, other, index) for index in indices if index < len(other[2]))
    }


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
        for before, after in pairwise(play(env, episode)):
            for index in np.flatnonzero(before[2] | before[3]).tolist():
                if after[1][index] or after[4]["agent_rewards"][index].any():
                    yield "A sub-environment that has finished still earns rewards."
                changed = set(differences(before, after, index)) - {"rewards", "agent_rewards"}
                if changed & {"terminated", "truncated"}:
                    yield "A sub-environment that has finished does not keep its flag up."
                elif changed:
                    names = ", ".join(sorted(changed))
                    yield f"A sub-environment that has finished goes on ({names}); it must stand still until a reset."
        if not (env.terminated | env.truncated).all():
            limit = f"env.episode_limit = {env.episode_limit} steps"
            yield f"An episode goes on after {limit}; the last one must truncate it."
            return


def randomness(make: Make) -> Iterator[str]:
    """What sub-environment i plays in its k-th episode depends on (seed, i, k) alone."""
    last = EPISODES - 1
    env, again, alone, later = make(3, 7, True), make(3, 7, True), make(1, 7, True), make(3, 7, True)
    later.episode = last
    for episode in range(EPISODES):
        others = [play(again, episode), play(alone, episode)] + [play(later, last)] * (episode == last)
        differ = differing(play(env, episode), *others, indices=range(3))
        if 0 in differ:
            yield "The same seed does not play the same episodes: runs cannot be repeated, nor resumed exactly."
            return
        if 1 in differ:
            yield "Sub-environment 0 plays something else when there are others beside it."
        if 2 in differ:
            yield (
                f"Episode {last} is another one if those before it were not played (env.episode = {last}, then a "
                "reset). So it does not depend on the seed alone, and a resumed run would differ."
            )
    if differing(play(make(3, 7, True), 0), play(make(3, 0, True), 0, seed=7), indices=range(3)):
        yield "reset(seed=7) does not begin the episodes of an environment that was made with seed 7."


def shared_generators() -> dict[str, tuple[Callable[[], Any], Callable[[Any], Any], Callable[[int], Any]]]:
    """The generators that a whole program shares, by the call that seeds them: how to read, set and seed their states.

    PyTorch's is among them where PyTorch is in use.
    """
    found: dict[str, Any] = {
        "random.seed": (random.getstate, random.setstate, random.seed),
        "numpy.random.seed": (np.random.get_state, np.random.set_state, np.random.seed),
    }
    if torch := sys.modules.get("torch"):
        found["torch.manual_seed"] = (torch.get_rng_state, torch.set_rng_state, torch.manual_seed)
    return found


def generators(make: Make) -> Iterator[str]:
    """The generators that a whole program shares (torch's, numpy's, Python's) are not seeded anew."""
    shared = shared_generators()
    before = {call: read() for call, (read, _, _) in shared.items()}
    runs = [states_after(make, seed) for seed in (1, 1, 2)]
    for call, (_, restore, _) in shared.items():
        restore(before[call])
    for call in shared:
        moments = []
        for moment in runs[0]:
            first, again, other = (run[moment][call] for run in runs)
            if first == other or first != again:  # not what drawing from a generator leads to
                moments.append(f"when {moment}")
        if moments:
            yield (
                f"The environment calls {call}, or something like it, {' and '.join(moments)}. A whole program shares "
                "that generator, so whatever else draws from it repeats itself."
            )


def settings(make: Make) -> Iterator[str]:
    """Settings that a whole program shares (PyTorch's, NumPy's, the working directory) stay as they are."""
    before = Settings.now()
    last_of(play(make(1, 0, True), 0))
    after = Settings.now()
    before.hold(after)
    if changed := before.changed(after):
        names = ", ".join(SETTINGS[name] for name in changed)
        yield f"The environment changes settings of the whole program ({names}), on which a training depends."


def states_after(make: Make, seed: int) -> dict[str, dict[str, bytes]]:
    """The states of the shared generators after three moments, if they have been seeded with `seed` before each."""
    shared = shared_generators()
    states: dict[str, dict[str, bytes]] = {}
    env: Any = None
    for moment in ("it is made", "an episode begins", "it makes a step"):
        for _, _, seed_one in shared.values():
            seed_one(seed)
        if env is None:
            env = make(2, 7, True)
        elif "episode" in moment:
            env.reset()
        else:
            env.step(env.action_mask.argmax(axis=2))
        for call, (read, _, _) in shared.items():
            state = read()
            in_bytes = state.numpy().tobytes() if "torch" in call else pickle.dumps(state)
            states.setdefault(moment, {})[call] = in_bytes
    return states


def refusals(make: Make) -> Iterator[str]:
    """Actions that do not exist or are forbidden."""
    env = make(2, 0, True)
    wrong = {  # before which step, and of which sub-environment and agent
        "an action that does not exist": (0, 1, env.n_agents - 1, env.n_actions),
        "an action below 0": (0, 0, 0, -1),
    }
    for t, (step, _) in enumerate(pairwise(play(env, 0))):
        for index, agent, action in np.argwhere(~step[4]["action_mask"])[:1].tolist():
            wrong.setdefault("an action that the mask forbids", (t, index, agent, action))
    for kind, where in wrong.items():
        whole, env, errors = make(2, 0, True), make(2, 0, True), list[str]()
        differs = differing(play(whole, 0), play(env, 0, before=partial(attempt, env, where, errors)), indices=range(2))
        if not errors:
            yield f"A step with {kind} must raise ValueError."
            continue
        if not all(str(number) in errors[0] for number in where[1:]):
            yield f"The error for {kind} must name sub-environment, agent and action; it says: {errors[0]}"
        if errors[1:] or differs:
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
    before = last_of(play(env, 0))
    observations, info = env.reset(options={"reset_mask": np.array([False, True, False])})
    after = (observations, env.rewards, env.terminated, env.truncated, info)
    if differences(before, after, 0) or differences(before, after, 2):
        yield "A reset with options['reset_mask'] changes sub-environments that the mask does not name."
    if env.terminated[1] or env.truncated[1]:
        yield "A reset with options['reset_mask'] does not take down the flag of a sub-environment that it names."
    ended = min(t for t, step in enumerate(play(make(3, 0, True), 0)) if (step[2] | step[3])[[0, 2]].any())
    whole, env = make(3, 0, True), make(3, 0, True)
    if differing(play(whole, 0), play(env, 0, before=partial(restart, env, ended // 2)), indices=(0, 2)):
        yield "A reset with options['reset_mask'] in the middle changes sub-environments that the mask does not name."


def restart(env: VectorEnv, when: int, t: int, masks: Masks) -> Masks:
    """Before step `when` of an episode, resets sub-environment 1 alone. See `play` for the others."""
    if t == when:
        masks = env.reset(options={"reset_mask": np.arange(env.num_envs) == 1})[1]["action_mask"]
    return masks


def copies(make: Make) -> Iterator[str]:
    """With copy=True the caller may keep what it got; with copy=False it gets the same arrays each time."""
    env, shared = make(2, 0, True), make(2, 0, False)
    for before, after in pairwise(step for episode in range(2) for step in play(env, episode)):
        kept, new = named(before), named(after)
        for name in (name for name in kept if name in new):
            if np.may_share_memory(kept[name], new[name]):
                yield f"With copy=True, a step writes into the arrays that an earlier one returned ({name})."
    if last_of(play(shared, 0))[0] is not shared.observations:
        yield "With copy=False, a step must return the environment's own arrays."
