"""Scripted policies for battles, those of the recorded results of SMAClite, and a loop that plays with them.

A policy takes the environment and a random generator, and returns actions [num_envs, n_agents] for all battles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.families.smaclite.environment import Env
from envs.families.smaclite.rules import ATTACK, EAST, NORTH, SOUTH, STOP, WEST

Policy = Callable[[Env, np.random.Generator], NDArray[np.int64]]


def play(env: Env, policy: Policy, seed: int = 0) -> dict[str, NDArray[Any]]:
    """One episode in each sub-environment: its length, return, win and survivors, each [num_envs]."""
    rng = np.random.default_rng(seed)
    env.reset()
    length, score = np.zeros(env.num_envs), np.zeros(env.num_envs)
    going = np.ones(env.num_envs, bool)
    while going.any():
        length += going
        _, rewards, terminated, truncated, _ = env.step(policy(env, rng))
        score += rewards
        going = ~(terminated | truncated)
    enemies = env.game.unit.shape[1] - env.n_agents
    return {
        "length": length,
        "return": score,
        "win": env.statistics["battle_won"].astype(float),
        "allies_alive": env.n_agents - env.statistics["dead_allies"].astype(float),
        "enemies_alive": enemies - env.statistics["dead_enemies"].astype(float),
        "hit_limit": env.truncated.astype(float),
    }


def random(env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
    """Uniform over what the mask allows."""
    return np.argmax(rng.random(env.action_mask.shape) * env.action_mask, axis=2)


def always(action: int) -> Policy:
    """That action where the mask allows it, else stop; nothing for the dead."""

    def act(env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
        mask = env.action_mask
        return np.where(mask[:, :, action], action, np.where(mask[:, :, STOP], STOP, 0))

    return act


def walk(mask: NDArray[np.bool_], across: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.int64]:
    """One agent's step in that direction: along its larger part, where that is masked along the other, else none."""
    horizontal = np.where(across > 0, EAST, np.where(across < 0, WEST, 0))
    vertical = np.where(up > 0, NORTH, np.where(up < 0, SOUTH, 0))
    sideways = abs(across) > abs(up)
    actions = np.full(len(mask), STOP)
    for choice in (np.where(sideways, vertical, horizontal), np.where(sideways, horizontal, vertical)):
        allowed = (choice > 0) & mask[np.arange(len(mask)), choice]
        actions = np.where(allowed, choice, actions)
    return actions


def attack_nearest(env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
    """Attack the nearest enemy among those that may be attacked; else walk to the nearest.

    Healers heal the ally with the smallest part of its hp left; else they follow the nearest ally.
    """
    unit, n_allies = env.game.unit, env.n_agents
    alive = unit.hp > 0
    actions = np.zeros((env.num_envs, n_allies), np.int64)
    every = np.arange(env.num_envs)
    for i in range(n_allies):
        mask = env.action_mask[:, i]
        across, up = unit.x - unit.x[:, i, None], unit.y - unit.y[:, i, None]
        squared = across**2 + up**2
        if unit.heals[0, i]:
            targets = slice(0, n_allies)
            fraction = unit.hp[:, targets] / unit.max_hp[:, targets]
            value = np.where(mask[:, ATTACK : ATTACK + n_allies], fraction, 1)
            good = value.min(axis=1) < 1
            friends = alive & ~unit.heals
            friends[:, n_allies:] = False
            to_follow = np.where(friends, squared, np.inf)
            stay = (to_follow.min(axis=1) <= 9) | ~friends.any(axis=1)
        else:
            targets = slice(n_allies, unit.shape[1])
            hittable = ~unit.flies | unit.hits_air[:, i, None]
            possible = mask[:, ATTACK : ATTACK + unit.shape[1] - n_allies] & hittable[:, targets]
            value = np.where(possible, squared[:, targets], np.inf)
            good = possible.any(axis=1)
            enemies = alive & hittable
            enemies[:, :n_allies] = False
            to_follow = np.where(enemies, squared, np.inf)
            stay = ~enemies.any(axis=1)
        there = to_follow.argmin(axis=1)
        steps = np.where(stay, STOP, walk(mask, across[every, there], up[every, there]))
        actions[:, i] = np.where(good, ATTACK + value.argmin(axis=1), steps)
    return np.where(alive[:, :n_allies], actions, 0)


def attack_eps20(env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
    """Each agent acts at random with probability 0.2, else as `attack_nearest`."""
    at_random = rng.random((env.num_envs, env.n_agents)) < 0.2
    return np.where(at_random, random(env, rng), attack_nearest(env, rng))


def wait_at(x: float, y: float) -> Policy:
    """Walk to that place and stay there; attack the nearest enemy among those that may be attacked."""

    def act(env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
        actions = attack_nearest(env, rng)
        for i in range(env.n_agents):
            mask = env.action_mask[:, i]
            across, up = x - env.game.unit.x[:, i], y - env.game.unit.y[:, i]
            steps = np.where(across**2 + up**2 < 1, STOP, walk(mask, across, up))
            idle = mask[:, STOP] & ~mask[:, ATTACK:].any(axis=1)
            actions[:, i] = np.where(idle, steps, actions[:, i])
        return actions

    return act


def kite(env: Env, rng: np.random.Generator, too_near: float = 2.5) -> NDArray[np.int64]:
    """Shoot, and run while the weapon cools down; for maps on which everybody shoots and nobody flies."""
    unit, n_allies = env.game.unit, env.n_agents
    actions = attack_nearest(env, rng)
    every = np.arange(env.num_envs)
    enemies = unit.hp[:, n_allies:] > 0
    for i in range(n_allies):
        mask = env.action_mask[:, i]
        x, y = unit.x[:, i], unit.y[:, i]
        across, up = unit.x[:, n_allies:] - x[:, None], unit.y[:, n_allies:] - y[:, None]
        distance = np.where(enemies, np.sqrt(across**2 + up**2), np.inf)
        nearest = distance.min(axis=1)
        target = mask[:, ATTACK:].any(axis=1)
        value = np.full((env.num_envs, 4), -np.inf)
        for k, (right, north) in enumerate(((0, 2), (0, -2), (2, 0), (-2, 0))):  # north, south, east, west
            to_x, to_y = x + right, y + north
            squared = (unit.x[:, n_allies:] - to_x[:, None]) ** 2 + (unit.y[:, n_allies:] - to_y[:, None]) ** 2
            danger = np.where(enemies, 1 / (0.3 + squared), 0).sum(axis=1)
            border = ((to_x - 16) / 13) ** 6 + ((to_y - 16) / 13) ** 6
            value[:, k] = np.where(mask[:, NORTH + k], -danger - 0.02 * border, -np.inf)
        away = np.where(mask[:, NORTH : WEST + 1].any(axis=1), NORTH + value.argmax(axis=1), STOP)
        there = distance.argmin(axis=1)
        nearer = walk(mask, across[every, there], up[every, there])
        retreat = np.where(~target & (nearest > 6.5), nearer, away)
        retreats = (unit.cooldown[:, i] > 0.3) | (nearest < too_near) | ~target
        actions[:, i] = np.where(retreats, retreat, actions[:, i])
    return np.where(unit.hp[:, :n_allies] > 0, actions, 0)


POLICIES: dict[str, Policy] = {
    "attack_nearest": attack_nearest,
    "attack_eps20": attack_eps20,
    "random": random,
    "pkite25": kite,
    "stop": always(STOP),
    "north": always(NORTH),
    "south": always(SOUTH),
    "east": always(EAST),
    "west": always(WEST),
}
