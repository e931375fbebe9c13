"""How often SMAC's own scripted policy wins our battles, for comparison with its win rates in StarCraft II.

    python tests/scripted.py [corridor-sc2-v2 ...] [--battles 300] [--moved 0.2]

SMAC's code has the policy as `get_agent_action_heuristic`: each unit takes the nearest enemy, keeps it until it is
dead, and attacks it; a medivac heals in the same way the nearest ally that is hurt. It has three forms here:

    anew    the nearest that may be attacked, chosen anew in each step; as `battles.attack_nearest`
    kept    the one that it keeps, when the mask allows the attack, else a step towards it (SMAC's `heuristic_rest`)
    far     the one that it keeps, at any distance, whatever the mask says (SMAC's default)

Each is played from the map's own starts, and from starts in which every unit that can move has been moved by up to 0.2
in both directions. The table has the won battles in percent, and the 95 % interval of Wilson.

    python tests/scripted.py --mirror [3s5z-sc2-v2 ...] [--battles 300] [--moved 0.2]

The same for battles of like sides that both play by the enemies' rules, from moved starts: if the rules favour nobody,
the allies win half of them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import battles
import numpy as np
from numpy.typing import NDArray

import envs
from envs.families.smaclite.environment import Env
from envs.families.smaclite.rules import ATTACK, NOBODY, NOWHERE, STOP, TICKS, WALK, tick

MIRRORS = ("3s5z-sc2-v2", "2s3z-sc2-v2")
PAPER_MAPS = ("2s_vs_1sc-sc2", "3s_vs_5z-sc2-v2", "3s5z-sc2-v2", "MMM2-sc2", "corridor-sc2-v2")


class Scripted:
    """SMAC's policy with targets that are kept: a `battles.Policy` for one battle in each sub-environment."""

    def __init__(self, far: bool) -> None:
        """far: attack at any distance; else what the mask forbids becomes a step towards the target."""
        self.far = far
        self.targets: NDArray[np.int64] | None = None  # [env, agent] among enemies, or for healers allies; -1: none yet

    def __call__(self, env: Env, rng: np.random.Generator) -> NDArray[np.int64]:
        unit, n_allies = env.game.unit, env.n_agents
        if self.targets is None:
            self.targets = np.full((env.num_envs, n_allies), -1)
        alive, every = unit.hp > 0, np.arange(env.num_envs)
        actions = np.full((env.num_envs, n_allies), STOP)
        for i in range(n_allies):
            if unit.heals[0, i]:
                side, fit = slice(0, n_allies), alive & (unit.hp < unit.max_hp) & ~unit.heals
            else:
                side, fit = slice(n_allies, unit.shape[1]), alive & (~unit.flies | unit.hits_air[:, i, None])
            across, up = unit.x[:, side] - unit.x[:, i, None], unit.y[:, side] - unit.y[:, i, None]
            fit = fit[:, side]
            nearest = np.where(fit, across**2 + up**2, np.inf).argmin(axis=1)
            target = self.targets[:, i]
            target = self.targets[:, i] = np.where((target >= 0) & fit[every, target], target, nearest)
            mask = env.action_mask[:, i]
            allowed = self.far | mask[every, ATTACK + target]
            steps = battles.walk(mask, across[every, target], up[every, target])
            actions[:, i] = np.where(fit.any(axis=1), np.where(allowed, ATTACK + target, steps), STOP)
        if self.far:
            env.action_mask[:] = True
        return np.where(alive[:, :n_allies], actions, 0)


FORMS: dict[str, Callable[[], battles.Policy]] = {
    "anew": lambda: battles.attack_nearest,
    "kept": lambda: Scripted(far=False),
    "far": lambda: Scripted(far=True),
}


def move_starts(env: Env, distance: float, seed: int = 7) -> None:
    """Let all following battles of each sub-environment begin with units up to so far from where the map puts them."""
    unit, rng = env.game.unit, np.random.default_rng(seed)
    for start in (unit.start_x, unit.start_y):
        start += np.where(unit.speed > 0, rng.uniform(-distance, distance, unit.shape), 0).astype(np.float32)


def won(name: str, form: str, n_battles: int, moved: float = 0) -> int:
    """How many of so many battles of `smaclite-<name>` the policy wins."""
    env = envs.make(f"smaclite-{name}", n_battles, seed=1)
    assert isinstance(env, Env)
    move_starts(env, moved)
    return int(battles.play(env, FORMS[form]())["win"].sum())


def mirror(name: str, n_battles: int, moved: float) -> int:
    """How many battles of `smaclite-<name>`, a map of like sides, allies win that play by the enemies' rules.

    Only enemies choose for themselves. So before each tick the choices are made in copies of the battle: the enemies'
    in one as it is, then, knowing these, the allies' in one with the sides exchanged. They are the allies' orders.
    """
    env, straight, turned = (envs.make(f"smaclite-{name}", n_battles, seed=1) for _ in range(3))
    assert isinstance(env, Env) and isinstance(straight, Env) and isinstance(turned, Env)
    n = env.n_agents
    allies, enemies = slice(n), slice(n, 2 * n)
    exchanged = np.r_[enemies, allies]
    renamed = np.r_[exchanged, NOBODY]
    unit = env.game.unit
    for goal, start in ((unit.goal_x, unit.start_x), (unit.goal_y, unit.start_y)):
        goal[:, allies] = 2 * start.mean(axis=1, keepdims=True) - goal[:, enemies]  # by 180 degrees
    move_starts(env, moved)
    for each in (env, straight, turned):
        each.reset()
    going, won = np.ones(n_battles, bool), np.zeros(n_battles, bool)

    def one_tick(of: Env) -> None:
        for e in np.flatnonzero(going):
            tick(of.game, of.config, e)

    for _ in range(env.episode_limit):
        unit.place[:] = NOWHERE  # as in each step of an episode
        for _ in range(TICKS):
            straight.game.unit[:] = unit
            one_tick(straight)
            copy = turned.game.unit
            copy[:] = unit[:, exchanged]
            copy.target[:, allies] = straight.game.unit.target[:, enemies]
            copy.target[:] = renamed[copy.target]
            copy.place[:, allies] = straight.game.unit.place[:, enemies]
            copy.order[:] = WALK
            copy.order[:, allies] = np.where(copy.target != NOBODY, copy.target, WALK)[:, allies]
            one_tick(turned)
            target = renamed[copy.target[:, enemies]]
            unit.order[:, allies] = np.where(target != NOBODY, target, WALK)
            unit.place[:, allies] = copy.place[:, enemies]
            one_tick(env)
        alive = unit.hp > 0
        won |= going & ~alive[:, enemies].any(axis=1)
        going &= alive[:, allies].any(axis=1) & alive[:, enemies].any(axis=1)
    return int(won.sum())


def interval(wins: int, n: int) -> tuple[float, float]:
    """Of Wilson, 95 %: the least and the largest share of victories that fit to so many of n."""
    z = 1.96
    middle, half = wins + z**2 / 2, z * (wins * (n - wins) / n + z**2 / 4) ** 0.5
    return (middle - half) / (n + z**2), (middle + half) / (n + z**2)


def percent(wins: int, n: int) -> str:
    """Wins in percent of n, and their interval."""
    low, high = interval(wins, n)
    return f"{100 * wins / n:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="*", help="the part of tasks' names behind smaclite-")
    parser.add_argument("--mirror", action="store_true", help="like sides that both play by the enemies' rules")
    parser.add_argument("--battles", type=int, default=300)
    parser.add_argument("--moved", type=float, default=0.2)
    args = parser.parse_args()
    if args.mirror:
        for name in args.maps or MIRRORS:
            print(f"| {name} | {percent(mirror(name, args.battles, args.moved), args.battles)} |", flush=True)
        return
    print("| map | starts | " + " | ".join(FORMS) + " |")
    print("|---|---|" + "---|" * len(FORMS))
    for name in args.maps or PAPER_MAPS:
        for moved in (0.0, args.moved):
            cells = [percent(won(name, form, args.battles, moved), args.battles) for form in FORMS]
            print(f"| {name} | {'moved' if moved else 'as they are'} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
