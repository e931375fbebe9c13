"""The environment of the battles: what is built from a map, and its pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families.smaclite.maps import RULE_SETS, SIZE, Polygon, formation, terrain
from envs.families.smaclite.rules import ATTACK, KILL, NOBODY, PERFECT, UNIT, WIN, Config, State, reset_all, step_all
from envs.families.smaclite.walking import EDGE, edges_near_cells, edges_of

# Colours and letters of a frame
WALL, GRAVE = (190, 186, 176), (170, 168, 162)
ALLY, ENEMY = (31, 105, 180), (200, 70, 30)
SHOT, BEAM = {ALLY: (120, 175, 230), ENEMY: (240, 150, 100)}, (60, 165, 85)
HEALTH, SHIELD = (60, 165, 85), (90, 150, 230)
AROUND = 3  # cells that a frame shows around the units
LETTERS = {
    "stalker": "S",
    "zealot": "Z",
    "zergling": "z",
    "marine": "m",
    "marauder": "M",
    "medivac": "+",
    "spine crawler": "C",
}


class Env(vector.VectorEnv):
    """A battle; see the package's docstring."""

    can_draw = True

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

    def frame(self, index: int = 0) -> NDArray[np.uint8]:
        """The battle of one sub-environment: units as discs with the letter of their type, allies blue, enemies red.

        Above a unit are bars of its hp (green) and its shield (blue); those that fly have a white edge. Lines join a
        unit to whom it has hit, or with a green one healed, in this step. Crosses are the dead.
        """
        from envs import render  # Pillow is needed only where something is drawn

        units = self.game.unit[index]
        rows, columns = np.nonzero(self.game.walkable)
        corner = np.maximum([columns.min() - 1, rows.min() - 1], 0)
        map_size = np.minimum([columns.max() + 2, rows.max() + 2], SIZE) - corner
        width, height = map_size * (640 // map_size.max())  # in pixels
        # The picture shows the part of the map where units are, dead ones too. It grows in eighths of the map and moves
        # by two cells at once, so that it mostly stands still.
        spots = np.stack([units.x, units.y], axis=1)
        needed = (np.ptp(spots, axis=0) + 2 * AROUND) / map_size
        view_size = map_size * min(np.ceil(8 * needed.max()) / 8, 1)
        wanted = (spots.min(axis=0) + spots.max(axis=0) - view_size) / 2
        left, bottom = np.clip(2 * np.round(wanted / 2), corner, corner + map_size - view_size)
        top = bottom + view_size[1]
        cell, margin, caption = width / view_size[0], 10, 34
        canvas = render.Canvas(width + 2 * margin, height + margin + caption)

        def place(x: float, y: float) -> tuple[float, float]:
            return margin + (x - left) * cell, caption + (top - y) * cell

        def polygon(corners: Polygon, colour: render.Colour) -> None:
            points = [place(*corner) for corner in corners]
            canvas.pen.polygon([(x * render.DETAIL, y * render.DETAIL) for x, y in points], fill=colour)

        for wall in self.walls:
            polygon(wall, WALL)
        for frame in (  # what lies outside the part that is shown
            [(0, 0), (width + 2 * margin, caption)],
            [(0, 0), (margin, height + caption + margin)],
            [(width + margin, 0), (width + 2 * margin, height + caption + margin)],
            [(0, height + caption), (width + 2 * margin, height + caption + margin)],
        ):
            canvas.pen.rectangle([(x * render.DETAIL, y * render.DETAIL) for x, y in frame], fill=render.PAPER)
        canvas.text(margin, caption / 2, f"step {self.game.steps[index]} / {self.episode_limit}", 15, anchor="lm")
        canvas.text(margin + width / 2, caption / 2, self.name, 15)
        canvas.text(margin + width, caption / 2, f"return {self.game.score[index]:.2f}", 15, anchor="rm")

        places = [place(unit.x, unit.y) for unit in units]
        colours = [ALLY] * self.n_agents + [ENEMY] * (len(units) - self.n_agents)
        for unit, (x, y) in zip(units, places):
            if unit.hp == 0:
                half = 0.5 * unit.body * cell
                canvas.line(x - half, y - half, x + half, y + half, GRAVE, 2)
                canvas.line(x - half, y + half, x + half, y - half, GRAVE, 2)
        for unit, start, colour in zip(units, places, colours):
            if unit.shot != NOBODY:
                beam = BEAM if unit.heals else SHOT[colour]
                canvas.line(*start, *places[int(unit.shot)], beam, 3 if unit.heals else 1.5)
        for flying in (False, True):
            for unit, (x, y), colour, name in zip(units, places, colours, self.unit_names):
                if unit.hp == 0 or unit.flies != flying:
                    continue
                radius = unit.body * cell
                canvas.circle(x, y, radius, colour, render.WHITE if flying else None, 1.5)
                canvas.text(x, y, LETTERS.get(name, name[:2]), 1.3 * radius, render.WHITE)
        for unit, (x, y) in zip(units, places):
            parts = [(unit.hp / unit.max_hp, HEALTH)]
            if unit.max_shield > 0:
                parts.append((unit.shield / unit.max_shield, SHIELD))
            length, level = 2 * unit.body * cell, y - unit.body * cell
            for part, colour in parts if unit.hp > 0 else ():
                level -= 3
                canvas.line(x - length / 2, level, x + length / 2, level, GRAVE, 2)
                if part > 0:
                    canvas.line(x - length / 2, level, x + (part - 0.5) * length, level, colour, 2)
        return canvas.frame()
