"""The environment of the battles: what is built from a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families.smaclite.maps import RULE_SETS, formation, terrain
from envs.families.smaclite.rules import ATTACK, KILL, PERFECT, UNIT, WIN, Config, State, reset_all, step_all
from envs.families.smaclite.walking import EDGE, edges_near_cells, edges_of


class Env(vector.VectorEnv):
    """A battle; see the package's docstring."""

    can_draw, picture = True, "envs.pictures.smaclite"

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool, *, map_name: str, rule_set: str) -> None:
        """map_name, rule_set: keys of the tables in `maps`."""
        rules, types, maps = RULE_SETS[rule_set]
        field = maps[map_name]
        self.field = field
        radii = [[types[unit].radius for unit in group.units] for group in (*field.allies, field.enemies)]
        places = [place for group, r in zip(field.allies, radii) for place in formation(group, r, 1)]
        places += formation(field.enemies, radii[-1], -1)
        allies = [unit for group in field.allies for unit in group.units]
        enemies = list(field.enemies.units)
        n_allies, n_enemies = len(allies), len(enemies)
        self.unit_names = allies + enemies
        units = [types[unit] for unit in self.unit_names]
        n_units = len(units)
        n_types = max(len(field.ally_types), len(field.enemy_types))
        bits = [field.ally_types.index(unit) if field.ally_types else 0 for unit in allies]
        bits += [field.enemy_types.index(unit) if field.enemy_types else 0 for unit in enemies]

        healers = any(unit.heals for unit in units[:n_allies])
        n_actions = ATTACK + (max(n_allies, n_enemies) if healers else n_enemies)
        ally_shields = any(unit.shield for unit in units[:n_allies])
        enemy_shields = any(unit.shield for unit in units[n_allies:])
        ally_size, enemy_size = 5 + ally_shields + n_types, 5 + enemy_shields + n_types
        obs_size = 4 + n_enemies * enemy_size + (n_allies - 1) * ally_size + ally_size - 4
        state_size = n_allies * (ally_size - 1) + n_enemies * (enemy_size - 2) + n_allies * n_actions
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=n_allies,
            n_actions=n_actions,
            obs_size=obs_size,
            state_size=state_size,
            episode_limit=field.episode_limit,
            low=-1,
            high=1,
            statistics=("battle_won", "dead_allies", "dead_enemies"),
        )
        bodies = np.array([unit.body or unit.radius for unit in units])
        speeds = np.array([unit.speed for unit in units])
        walkable, self.walls = terrain(field)
        edges = [edge for wall in self.walls for edge in edges_of(wall)]
        edge = np.array(edges, EDGE).view(np.recarray)
        values = sum(unit.hp + unit.shield for unit in units[n_allies:]) + KILL * n_enemies + WIN
        self.config = Config(
            *rules,
            n_allies=n_allies,
            episode_limit=field.episode_limit,
            reward_scale=PERFECT / values,
            largest_body=float(bodies.max()),
            largest_radius=max(unit.radius for unit in units),
            enemies_first=field.enemies_first,
            ally_shields=ally_shields,
            enemy_shields=enemy_shields,
            n_types=n_types,
        )

        unit = np.zeros((num_envs, n_units), UNIT).view(np.recarray)
        for i, described in enumerate(units):
            for column in described._fields:
                if column in unit.dtype.names:
                    unit[column][:, i] = getattr(described, column)
        unit.body[:] = bodies
        unit.full_cooldown[:] = [described.cooldown for described in units]
        unit.max_hp[:] = [described.hp for described in units]
        unit.max_shield[:] = [described.shield for described in units]
        unit.type_bit[:] = bits
        unit.start_x[:], unit.start_y[:] = np.array(places, np.float32).T[:, None]
        unit.goal_x[:], unit.goal_y[:] = field.attack_point
        n_lines = len(edges) + n_units
        self.game = State(
            random=np.zeros(num_envs, np.uint64),
            steps=np.zeros(num_envs, np.int64),
            score=np.zeros(num_envs),
            gain=np.zeros(num_envs),
            turn=np.zeros((num_envs, n_units), np.int64),
            unit=unit,
            last_action=np.zeros((num_envs, n_allies), np.int64),
            walkable=walkable,
            edge=edge,
            near_edges=edges_near_cells(edge, float((bodies + speeds).max())),
            near=np.zeros(n_units, np.int64),
            distance=np.zeros(n_units),
            line=np.zeros((n_lines, 4)),
            projected=np.zeros((n_lines, 4)),
            observations=self.observations,
            state=self.state,
            action_mask=self.action_mask,
            agent_rewards=self.agent_rewards,
            rewards=self.rewards,
            terminated=self.terminated,
            truncated=self.truncated,
            battle_won=self.statistics["battle_won"],
            dead_allies=self.statistics["dead_allies"],
            dead_enemies=self.statistics["dead_enemies"],
        )

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        reset_all(self.game, self.config, mask, seed, episodes)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        return step_all(self.game, self.config, actions, playing)
