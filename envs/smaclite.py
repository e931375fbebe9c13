"""Battles of small groups, in the manner of SMAC, the StarCraft multi-agent challenge (Samvelyan et al., 2019).

    smaclite-<map>[-sc2]        2s_vs_1sc, 3s5z, MMM2, corridor, 3s_vs_5z (the paper's), 3m, 8m, 2s3z

This is our own simulator, written from a description of the rules, and needs no StarCraft. Without -sc2 it has the
rules of SMAClite (Michalski, Christianos and Albrecht, 2023), against whose battles it is checked. With -sc2 the same
engine is as near to StarCraft II as it can be: `envs.smaclite_maps` has units, maps and all differences as tables.

Each agent commands one unit; the enemies follow rules. Units are stalkers (s), zealots (z), a spine crawler (sc),
zerglings, and the marines, marauders and medivac of MMM2. Coordinates lie in 0 .. 32, x to the east, y to the north. A
step is 8 ticks of 1/16 s.

Actions: 0 nothing, for the dead and only for them; 1 stop; 2 north, 3 south, 4 east, 5 west: walk, for this step,
towards a point 2 away; 6 + k attack enemy k, or for a medivac heal ally k, until the next step: walk to it, shoot or
heal within reach. The mask allows a walk where the point 1 away is on the map and not in a wall, an attack on living
enemies up to 6 away (also those that the unit cannot hit: only some hit what flies), healing of living allies up to 6
away that are no healers themselves. Distances are between centres, except that of a weapon's reach, between edges.

Observation of a living agent (zeros for a dead one):
    whether it may walk north, south, east, west;
    of each enemy: whether it may be attacked, distance / 9, x and y relative to the agent / 9, hp, shield, type;
    of each other ally: 1, distance / 9, relative x and y / 9, hp, shield, type;
    its own hp, shield, type.
hp and shield are parts of their maximum, the type is a bit for each type that the map's table lists. Shields are left
out where a side has none, types where it has only one. Dead units, and those 9 away or more, are zeros. (For a medivac,
as in SMAC, "may be attacked" of enemy k is whether it may heal ally k.)
State: of each ally hp, cooldown of the weapon (a part of the whole or, with -sc2, of SMAC's constants; for a medivac
energy / 200), (x - 16) / 32, (y - 16) / 32, shield, type; of each enemy hp, x, y, shield, type, in the same way; zeros
for the dead; then each agent's last action, one bit for each action.

Reward, the same for all agents: the damage done to shields and hp of enemies, 10 for each killed, and 200 for the
victory, scaled such that an enemy side that does not regenerate is worth 20 in all. With -sc2 it is, as in SMAC, the
absolute difference of the enemies' health at the ends of a step, so that what they regenerate in a step is lost or,
when nobody shoots, even gained.
End: one side is dead, a termination; the map's own number of steps, a truncation. With -sc2 a side with nothing but
healers is dead, too, and a battle that nobody survives is not won. Statistics: battle_won, dead_allies, dead_enemies.

A tick: (1) An enemy keeps its target while that lives and is within reach, or attacks this enemy; only the spine
crawler of -sc2 does not. Without one it takes the nearest of all it can hit that are within its sight (see the tables)
or attack it. (Without -sc2 healers come first, and as long as one lives, an enemy that does not attack a healer chooses
anew in each tick.) A healer of the enemies takes the weakest on the ground around it that is hurt or busy. Who has
nobody walks to the map's point of attack, in a straight line, a healer no faster than those around it. Agents' units do
what they are told and nothing else. (2) Who has its target within reach stands and shoots, if its weapon has cooled
down; others walk. Units and walls are avoided as in ORCA, but who stands, stands like a rock. (3) In an order drawn
anew for each tick, units move, regenerate, shoot.

A hit takes the damage (more on armoured units) from the shield, the rest, less the armour, from the hp. Shields regain
2 per second after 10 s without a hit, zerg 0.38 (0.273 with -sc2). A medivac gives 9 hp per second, 3 for a point of
energy, of which it has 50 and regains 0.5625 per second; without -sc2 it saves a patient killed in this very tick if
its turn comes after the shot. Weapons of -sc2 take a random -1 to 2 ticks longer to cool; besides that, only the order
within a tick is random: episodes begin all alike, and without -sc2 a team that does the same again lives through almost
the same again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families.kernels import compiled, episode_state, forbidden_action, random_below
from envs.smaclite_maps import RULE_SETS, SIZE, Polygon, formation, terrain

NO_OP, STOP, NORTH, SOUTH, EAST, WEST, ATTACK = 0, 1, 2, 3, 4, 5, 6  # ATTACK + k: unit k
TICKS = 8  # of a step
TICK = 1 / 16  # seconds
MOVE = 2.0  # cells
RANGE = 6.0  # up to which a target may be chosen
SIGHT = 9.0
QUIET = 10.0  # seconds without a hit after which a shield regenerates
SHIELD_REGENERATION = 2.0  # per second
ENERGY, MOST_ENERGY, ENERGY_REGENERATION = 50.0, 200.0, 0.5625  # of a healer: at the start, at most, per second
HEALING, HP_PER_ENERGY = 9.0, 3.0  # hp per second; hp that a point of energy buys
LEAST_ENERGY = 5.0  # to begin to heal somebody
KILL, WIN, PERFECT = 10.0, 200.0, 20.0  # bonuses of the reward, and what a perfect battle returns in all

WALK, HOLD = -1, -2  # orders other than a unit to attack or to heal
NOBODY = -1
FAR = 1e6  # more than any squared distance
SECOND_CHOICE = 1e7  # more than FAR
PARALLEL = 1e-5

# Colours and letters of a frame
WALL, GRAVE = (190, 186, 176), (170, 168, 162)
ALLY, ENEMY = (31, 105, 180), (200, 70, 30)
SHOT, BEAM = {ALLY: (120, 175, 230), ENEMY: (240, 150, 100)}, (60, 165, 85)
HEALTH, SHIELD = (60, 165, 85), (90, 150, 230)
LETTERS = {
    "stalker": "S",
    "zealot": "Z",
    "zergling": "z",
    "marine": "m",
    "marauder": "M",
    "medivac": "+",
    "spine crawler": "C",
}


UNIT = np.dtype(
    [
        # What its type says; see `smaclite_maps.Unit`
        ("max_hp", float),
        ("max_shield", float),
        ("armour", float),
        ("damage", float),
        ("bonus", float),
        ("hits", int),
        ("reach", float),
        ("radius", float),
        ("body", float),
        ("speed", float),
        ("full_cooldown", float),
        ("cooldown_scale", float),
        ("sight", float),
        ("regeneration", float),
        ("armoured", bool),
        ("flies", bool),
        ("hits_air", bool),
        ("looks_around", bool),
        ("heals", bool),
        ("type_bit", int),  # which of the bits for its type is 1 in observations
        # What the map says
        ("start_x", float),
        ("start_y", float),
        # What happens
        ("x", float),  # where it stands, or where it fell
        ("y", float),
        ("velocity_x", float),  # of the last tick, in cells per second
        ("velocity_y", float),
        ("wanted_x", float),  # the velocity that it would like in this tick
        ("wanted_y", float),
        ("chosen_x", float),  # and the one near to it that avoids collisions
        ("chosen_y", float),
        ("goal_x", float),  # where it walks when it has no target
        ("goal_y", float),
        ("hp", float),  # 0: it is dead
        ("shield", float),
        ("energy", float),  # of a healer
        ("bought", float),  # hp that a healer has paid for and not yet given
        ("cooldown", float),  # seconds until it can attack again
        ("quiet", float),  # seconds until its shield regenerates
        ("order", int),  # the unit to attack or heal, WALK or HOLD; enemies always have WALK
        ("target", int),  # the unit that it attacks or heals or is on its way to, or NOBODY
        ("last_target", int),  # its target one tick ago
        ("fires", bool),  # its target is within its reach
        ("shot", int),  # whom it hit or healed last in this step, or NOBODY
    ],
    align=True,
)
EDGE = np.dtype(
    [
        ("ax", float),  # where it starts; the wall lies to the left of it
        ("ay", float),
        ("bx", float),  # where it ends
        ("by", float),
        ("tx", float),  # its direction
        ("ty", float),
        ("before_x", float),  # the direction of the edge before, and of the one after
        ("before_y", float),
        ("after_x", float),
        ("after_y", float),
        ("left", float),  # a box around the wall
        ("bottom", float),
        ("right", float),
        ("top", float),
    ]
)


class State(NamedTuple):
    """One battle per entry of the leading axis. Units are numbered through: first the allies, then the enemies."""

    random: NDArray[np.uint64]  # [env] the generator's state
    steps: NDArray[np.int64]  # [env]
    score: NDArray[np.float64]  # [env] the return so far
    gain: NDArray[np.float64]  # [env] what this step's hits are worth
    turn: NDArray[np.int64]  # [env, place] the units in the order in which they move and shoot
    unit: Any  # [env, unit] records of the kind UNIT
    last_action: NDArray[np.int64]  # [env, agent]; -1 at the start
    walkable: NDArray[np.bool_]  # [row, column] of cells, for the mask
    edge: Any  # [edge] of all walls, records of the kind EDGE
    near_edges: NDArray[np.int64]  # [row, column, place] those that a unit in that cell may have to mind; then -1
    near: NDArray[np.int64]  # [place] room for the neighbours of one unit, nearest first
    distance: NDArray[np.float64]  # [place] and for their squared distances
    line: NDArray[np.float64]  # [line, (x, y, direction x, direction y)] room for the half-planes of one unit
    projected: NDArray[np.float64]  # [line, (x, y, direction x, direction y)] and for those of `least_collision`
    observations: NDArray[np.float32]  # [env, agent, value]
    state: NDArray[np.float32]  # [env, value]
    action_mask: NDArray[np.bool_]  # [env, agent, action]
    agent_rewards: NDArray[np.float32]  # [env, agent]
    rewards: NDArray[np.float32]  # [env]
    terminated: NDArray[np.bool_]  # [env]
    truncated: NDArray[np.bool_]  # [env]
    battle_won: NDArray[np.float32]  # [env]
    dead_allies: NDArray[np.float32]  # [env]
    dead_enemies: NDArray[np.float32]  # [env]


class Config(NamedTuple):
    """What the name says: the fields of `smaclite_maps.Rules`, and numbers of the map.

    It has no arrays, because a call with this tuple as an argument would count one more reference to each of them.
    """

    healers_first: bool
    weapon_jitter: bool
    least_damage: float
    reward_by_difference: bool
    draw_wins: bool
    healers_count: bool
    inside: bool
    revives: bool

    n_allies: int
    episode_limit: int
    reward_scale: float
    largest_body: float  # radius, in collisions
    largest_radius: float
    enemies_first: bool
    ally_shields: bool  # whether observations and state have a column for them
    enemy_shields: bool
    n_types: int  # bits for the type of a unit in observations and state


# ---------------------------------------------------------------------------------------------------------------------
# An episode and a step
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def reset_env(state, config, e):
    """Everybody stands where the map says, unhurt."""
    state.steps[e] = 0
    state.score[e] = 0
    state.last_action[e, :] = -1
    for i in range(state.unit.shape[1]):
        state.turn[e, i] = i
        me = state.unit[e, i]
        me.x, me.y = me.start_x, me.start_y
        me.velocity_x, me.velocity_y = 0.0, 0.0
        me.hp, me.shield = me.max_hp, me.max_shield
        me.energy = ENERGY if me.heals else 0.0
        me.bought = 0.0
        me.cooldown, me.quiet = 0.0, 0.0
        me.order = HOLD if i < config.n_allies else WALK
        me.target, me.shot = NOBODY, NOBODY
    state.battle_won[e] = 0
    state.dead_allies[e] = 0
    state.dead_enemies[e] = 0


@compiled
def step_env(state, config, e, actions):
    """Orders to the allies, eight ticks, the reward and the end."""
    unit = state.unit[e]
    n_allies, n_units = config.n_allies, len(unit)
    state.steps[e] += 1
    for i in range(n_allies):
        state.last_action[e, i] = actions[e, i]
        give_order(unit[i], actions[e, i], n_allies)
    for i in range(n_units):
        unit[i].shot = NOBODY

    health_before, standing_before = health_of_enemies(unit, n_allies)
    state.gain[e] = 0
    for _ in range(TICKS):
        tick(state, config, e)
    health, enemies = health_of_enemies(unit, n_allies)
    gain = state.gain[e]
    if config.reward_by_difference:
        gain = abs(health_before - health + KILL * (standing_before - enemies))

    allies = 0
    allies_who_count = 0
    enemies_who_count = 0
    for i in range(n_units):
        standing = unit[i].hp > 0
        counts = standing and (config.healers_count or not unit[i].heals)
        if i < n_allies:
            allies += standing
            allies_who_count += counts
        else:
            enemies_who_count += counts
    won = enemies_who_count == 0 and (allies_who_count > 0 or config.draw_wins)
    state.terminated[e] = enemies_who_count == 0 or allies_who_count == 0
    state.truncated[e] = not state.terminated[e] and state.steps[e] == config.episode_limit
    state.battle_won[e] = won
    state.dead_allies[e] = n_allies - allies
    state.dead_enemies[e] = n_units - n_allies - enemies
    reward = (gain + WIN * won) * config.reward_scale
    state.rewards[e] = reward
    state.agent_rewards[e, :] = reward
    state.score[e] += reward


@compiled
def give_order(me, action, n_allies):
    """An ally's action, as an order that stands for the whole step."""
    if action >= ATTACK:
        me.order = action - ATTACK + (0 if me.heals else n_allies)
    elif action >= NORTH:
        me.order = WALK
        me.goal_x = me.x + (MOVE if action == EAST else -MOVE if action == WEST else 0.0)
        me.goal_y = me.y + (MOVE if action == NORTH else -MOVE if action == SOUTH else 0.0)
    else:
        me.order = HOLD


@compiled
def health_of_enemies(unit, n_allies):
    """Their hp and shields in all, and how many of them live."""
    health = 0.0
    standing = 0
    for i in range(n_allies, len(unit)):
        health += unit[i].hp + unit[i].shield
        standing += unit[i].hp > 0
    return health, standing


@compiled
def tick(state, config, e):
    """All decide by what they see at the start of the tick; then they move and shoot, one after the other.

    The order, new in each tick, is all that is random in a battle, besides the jitter of weapons.
    """
    unit, turn, n_allies = state.unit[e], state.turn, config.n_allies
    n_units = len(unit)

    healer_lives = False
    for place in range(n_units):
        i = (place + n_allies) % n_units if config.enemies_first else place
        me = unit[i]
        me.last_target = me.target
        if i < n_allies:
            me.target = max(me.order, NOBODY)
            healer_lives |= me.heals and me.hp > 0
        if me.target != NOBODY:
            keep = unit[me.target].target == i or within_reach(me, unit[me.target])
            if unit[me.target].hp == 0 or (i >= n_allies and (me.looks_around or not keep)):
                me.target = NOBODY
    for i in range(n_units):
        me = unit[i]
        if me.hp == 0:
            continue
        speed = me.speed
        if i >= n_allies:
            if not me.heals:
                find_target(unit, i, config, healer_lives)
            elif me.target == NOBODY:
                speed = speed_of_company(unit, i, config)
                find_patient(unit, i, config)
        decide(unit, i, speed, n_allies)
    edge, near_edges = state.edge, state.near_edges
    near, distance, line, projected = state.near, state.distance, state.line, state.projected
    for i in range(n_units):
        if unit[i].hp > 0:
            avoid_collisions(unit, i, config.largest_body, edge, near_edges, near, distance, line, projected)

    for place in range(n_units - 1, 0, -1):
        other = random_below(state.random, e, place + 1)
        turn[e, place], turn[e, other] = turn[e, other], turn[e, place]
    for place in range(n_units):
        i = turn[e, place]
        me = unit[i]
        if me.hp == 0:
            continue
        move(me, config.inside)
        if me.fires and me.cooldown == 0:
            target = me.order if i < n_allies else me.target
            me.cooldown = me.full_cooldown
            if config.weapon_jitter and not me.heals:
                me.cooldown += (random_below(state.random, e, 4) - 1) * TICK
            if unit[target].hp == 0 and not (config.revives and me.heals and me.target == target):
                continue  # it died after the shot was decided
            me.shot = target
            if me.heals:
                heal(me, unit[target], target)
            else:
                damage = attack(me, unit[target], config.least_damage)
                if target >= n_allies:
                    state.gain[e] += damage + (KILL if unit[target].hp == 0 else 0.0)


# ---------------------------------------------------------------------------------------------------------------------
# Targets
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def squared_distance(me, other):
    """Between the centres of two units."""
    across, up = other.x - me.x, other.y - me.y
    return across * across + up * up


@compiled
def within_reach(me, other):
    """Whether a unit can attack or heal another one from where it stands, as far as distance goes."""
    reach = me.reach + me.radius + other.radius
    return squared_distance(me, other) <= reach * reach


@compiled
def find_target(unit, i, config, healer_lives):
    """An enemy without a target looks for one; with `healers_first` it looks for a better one while a healer lives.

    It sees who is near, and knows who attacks it wherever that is.
    """
    me = unit[i]
    better_only = me.target != NOBODY
    if better_only and not (config.healers_first and healer_lives and not unit[me.target].heals):
        return
    farthest = me.sight + config.largest_radius
    least = 2 * SECOND_CHOICE
    for j in range(config.n_allies):
        other = unit[j]
        if other.hp == 0 or (other.flies and not me.hits_air):
            continue
        distance = squared_distance(me, other)
        sight = me.sight + other.radius
        if distance >= sight * sight and other.target != i:
            continue
        if distance > farthest * farthest:
            if better_only:
                continue
            distance = FAR
        if config.healers_first and not other.heals:
            distance += SECOND_CHOICE
        if distance < least:
            least = distance
            me.target = j


@compiled
def find_patient(unit, i, config):
    """A healer of the enemies chooses the weakest unit near it that is hurt or has a target."""
    me = unit[i]
    least = math.inf
    for j in range(config.n_allies, len(unit)):
        other = unit[j]
        if other.hp == 0 or other.flies or (other.hp == other.max_hp and other.target == NOBODY):
            continue
        sight = me.sight + other.radius
        if other.hp < least and squared_distance(me, other) < sight * sight:
            least = other.hp
            me.target = j


@compiled
def speed_of_company(unit, i, config):
    """A healer of the enemies with nothing to do does not leave the units on the ground around it behind."""
    me = unit[i]
    speed = me.speed
    farthest = me.sight + config.largest_radius
    for j in range(config.n_allies, len(unit)):
        other = unit[j]
        if other.hp > 0 and not other.flies and squared_distance(me, other) < farthest * farthest:
            speed = min(speed, other.speed)
    return speed


@compiled
def decide(unit, i, speed, n_allies):
    """Stand and shoot if the target is within reach, else walk to it; without a target walk to the goal.

    An ally sticks to its order for the whole step, also when the unit that it was to attack has died.
    """
    me = unit[i]
    me.fires = False
    me.wanted_x, me.wanted_y = 0.0, 0.0
    target = me.order if i < n_allies else me.target
    if target == HOLD:
        return
    if target >= 0:
        other = unit[target]
        if within_reach(me, other) and (me.hits_air or not other.flies):
            me.fires = True
            return
        across, up = other.x - me.x, other.y - me.y
    else:
        across, up = me.goal_x - me.x, me.goal_y - me.y
    distance = math.sqrt(across * across + up * up)
    if distance > 0:
        me.wanted_x = speed * across / distance
        me.wanted_y = speed * up / distance


# ---------------------------------------------------------------------------------------------------------------------
# Moving and shooting
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def move(me, inside):
    """One tick forward, also for everything that time heals. Positions have the precision of 32 bits."""
    me.velocity_x, me.velocity_y = me.chosen_x, me.chosen_y
    x, y = me.x + me.chosen_x * TICK, me.y + me.chosen_y * TICK
    if inside:
        x, y = min(max(x, 0.0), float(SIZE)), min(max(y, 0.0), float(SIZE))
    me.x, me.y = np.float32(x), np.float32(y)
    me.cooldown = max(me.cooldown - TICK, 0.0)
    me.quiet = max(me.quiet - TICK, 0.0)
    if me.quiet == 0:
        me.shield = min(me.shield + SHIELD_REGENERATION * TICK, me.max_shield)
    me.hp = min(me.hp + me.regeneration * TICK, me.max_hp)
    if me.heals:
        me.energy = min(me.energy + ENERGY_REGENERATION * TICK, MOST_ENERGY)


@compiled
def attack(me, other, least_damage):
    """Each hit goes into the shield first, then, less the armour, into the hp. Returns the damage done."""
    done = 0.0
    for _ in range(me.hits):
        damage = me.damage + (me.bonus if other.armoured else 0.0)
        on_shield = min(damage, other.shield)
        on_hp = 0.0
        if damage > on_shield:
            on_hp = min(max(damage - on_shield - other.armour, least_damage), other.hp)
        other.shield -= on_shield
        other.hp -= on_hp
        done += on_shield + on_hp
    other.quiet = QUIET
    return done


@compiled
def heal(me, other, target):
    """Give as much hp as a tick allows. It is bought with energy, by the point, and what is left over is kept."""
    tired = me.energy < LEAST_ENERGY and me.last_target != target
    if tired or other.hp == other.max_hp:
        me.target, me.shot = NOBODY, NOBODY
        return
    gift = min(other.max_hp - other.hp, HEALING * TICK)
    if me.bought < gift:
        spent = min(1.0, me.energy)
        me.energy -= spent
        me.bought += HP_PER_ENERGY * spent
    gift = min(gift, me.bought)
    me.bought -= gift
    other.hp += gift


# ---------------------------------------------------------------------------------------------------------------------
# Collisions: optimal reciprocal collision avoidance (van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision
# avoidance", 2011), among units that stand immovable. Each neighbour and each wall allows a half-plane of velocities; a
# unit takes the allowed velocity nearest to the one that it wants.
#
# A line of `state.line` is a point and a direction; allowed is what lies on it or to the left of it.
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def det(ax, ay, bx, by):
    """Positive where b points to the left of a."""
    return ax * by - ay * bx


@compiled
def avoid_collisions(unit, i, largest, edge, near_edges, near, distance, line, projected):
    """The velocity for this tick. Who wants to stand, stands, whoever pushes."""
    me = unit[i]
    x, y = me.wanted_x, me.wanted_y
    if x != 0 or y != 0:
        n_walls = 0
        if not me.flies:
            n_walls = lines_of_walls(me, edge, near_edges, line)
        n_lines = lines_of_units(unit, i, largest, near, distance, line, n_walls)
        violated, x, y = best_velocity(line, n_lines, me.speed, x, y, False)
        if violated < n_lines:
            x, y = least_collision(line, projected, n_walls, n_lines, violated, me.speed, x, y)
    me.chosen_x, me.chosen_y = x, y


@compiled
def lines_of_units(unit, i, largest, near, distance, line, n_lines):
    """Append a line for each unit about to touch this one, nearest first; returns the number of lines.

    The velocities, relative to the neighbour, that lead to a collision within a second form a cone with a round tip.
    The line goes through the nearest velocity outside, or half of the way to it where the neighbour moves and so does
    the other half. Units that overlap part within a tick.
    """
    me = unit[i]
    farthest = (me.body + largest) ** 2
    n_near = 0
    for j in range(len(unit)):
        other = unit[j]
        squared = squared_distance(me, other)
        if squared > farthest or j == i or other.hp == 0 or other.flies != me.flies:
            continue
        place = n_near
        while place > 0 and distance[place - 1] > squared:
            distance[place] = distance[place - 1]
            near[place] = near[place - 1]
            place -= 1
        distance[place] = squared
        near[place] = j
        n_near += 1

    for place in range(n_near):
        other, squared = unit[near[place]], distance[place]
        to_x, to_y = other.x - me.x, other.y - me.y
        relative_x, relative_y = me.velocity_x - other.velocity_x, me.velocity_y - other.velocity_y
        together = me.body + other.body
        touching = squared <= together * together
        per_second = 1 / TICK if touching else 1.0
        # From the centre of the round tip to the relative velocity
        out_x, out_y = relative_x - per_second * to_x, relative_y - per_second * to_y
        length = math.sqrt(out_x * out_x + out_y * out_y)
        ahead = out_x * to_x + out_y * to_y
        if touching or (ahead < 0 and ahead * ahead > together * together * length * length):
            to_go = together * per_second - length
            if length == 0:  # all ways out are as far
                out_x, length = 1.0, 1.0
            out_x, out_y = out_x / length, out_y / length
            direction_x, direction_y = out_y, -out_x
            change_x, change_y = to_go * out_x, to_go * out_y
        else:
            leg = math.sqrt(squared - together * together)
            if det(to_x, to_y, out_x, out_y) > 0:
                direction_x = (to_x * leg - to_y * together) / squared
                direction_y = (to_y * leg + to_x * together) / squared
            else:
                direction_x = -(to_x * leg + to_y * together) / squared
                direction_y = -(to_y * leg - to_x * together) / squared
            along = relative_x * direction_x + relative_y * direction_y
            change_x, change_y = along * direction_x - relative_x, along * direction_y - relative_y
        share = 0.5 if other.wanted_x != 0 or other.wanted_y != 0 else 1.0
        x, y = me.velocity_x + share * change_x, me.velocity_y + share * change_y
        n_lines = append_line(line, n_lines, x, y, direction_x, direction_y)
    return n_lines


@compiled
def lines_of_walls(me, edge, near_edges, line):
    """The lines of the walls that this unit could touch within a second; returns their number."""
    column = min(max(math.floor(me.x), 0), SIZE - 1)
    row = min(max(math.floor(me.y), 0), SIZE - 1)
    farthest = me.body + me.speed
    n_lines = 0
    for place in range(near_edges.shape[2]):
        k = near_edges[row, column, place]
        if k < 0:
            break
        one = edge[k]
        across = max(one.left - me.x, me.x - one.right, 0.0)
        up = max(one.bottom - me.y, me.y - one.top, 0.0)
        if across * across + up * up < farthest * farthest:
            n_lines = line_of_edge(me, one, line, n_lines)
    return n_lines


@compiled
def line_of_edge(me, edge, line, n_lines):
    """Append the line of one edge of a wall, if it has one; returns the number of lines.

    Velocities that lead into the edge, as thick as the unit, within a second are forbidden: they form a wedge between
    two legs, cut off by the edge. The line touches this region where it is nearest to the velocity of the last tick.
    """
    r, vx, vy = me.body, me.velocity_x, me.velocity_y
    # From here on all is relative to the unit: a the start of the edge, b its end, t its direction.
    ax, ay = edge.ax - me.x, edge.ay - me.y
    bx, by = edge.bx - me.x, edge.by - me.y
    tx, ty = edge.tx, edge.ty
    height = det(tx, ty, ax, ay)  # of the unit above the outer side
    if height <= 0:
        return n_lines
    for other in range(n_lines):  # behind an earlier line?
        px, py, dx, dy = line[other, 0], line[other, 1], line[other, 2], line[other, 3]
        a_behind = det(ax - px, ay - py, dx, dy) - r >= -PARALLEL
        if a_behind and det(bx - px, by - py, dx, dy) - r >= -PARALLEL:
            return n_lines
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    before_a = ax * tx + ay * ty > 0
    after_b = bx * tx + by * ty < 0

    if before_a and a2 <= r * r:
        length = math.sqrt(a2)
        return append_line(line, n_lines, 0.0, 0.0, -ay / length, ax / length)
    if after_b and b2 <= r * r:
        if det(bx, by, edge.after_x, edge.after_y) < 0:
            return n_lines
        length = math.sqrt(b2)
        return append_line(line, n_lines, 0.0, 0.0, -by / length, bx / length)
    if not before_a and not after_b and height <= r:
        return append_line(line, n_lines, 0.0, 0.0, -tx, -ty)

    # The legs; a unit that sees the edge from its end has both at the one corner.
    before_x, before_y, after_x, after_y = edge.before_x, edge.before_y, edge.after_x, edge.after_y
    corner = height <= r
    if corner and before_a:
        bx, by, b2 = ax, ay, a2
        after_x, after_y = tx, ty
    elif corner:
        ax, ay, a2 = bx, by, b2
        before_x, before_y = tx, ty
    tangent = math.sqrt(a2 - r * r)
    left_x, left_y = (ax * tangent - ay * r) / a2, (ay * tangent + ax * r) / a2
    tangent = math.sqrt(b2 - r * r)
    right_x, right_y = (bx * tangent + by * r) / b2, (by * tangent - bx * r) / b2
    # Where the neighbouring edge is in front of a leg, its direction takes the leg's place, and the line is its own.
    left_foreign = det(left_x, left_y, -before_x, -before_y) >= 0
    if left_foreign:
        left_x, left_y = -before_x, -before_y
    right_foreign = det(right_x, right_y, after_x, after_y) <= 0
    if right_foreign:
        right_x, right_y = after_x, after_y

    # Where is the velocity nearest to the region: at a corner, the edge or a leg?
    from_a_x, from_a_y, from_b_x, from_b_y = vx - ax, vy - ay, vx - bx, vy - by
    cx, cy = bx - ax, by - ay
    on_edge = 0.5
    if not corner:
        on_edge = (from_a_x * cx + from_a_y * cy) / (cx * cx + cy * cy)
    on_left = from_a_x * left_x + from_a_y * left_y
    on_right = from_b_x * right_x + from_b_y * right_y
    if (on_edge < 0 and on_left < 0) or (corner and on_left < 0 and on_right < 0):
        return append_tangent(line, n_lines, ax, ay, from_a_x, from_a_y, r)
    if on_edge > 1 and on_right < 0:
        return append_tangent(line, n_lines, bx, by, from_b_x, from_b_y, r)
    to_edge, to_left, to_right = math.inf, math.inf, math.inf
    if not corner and 0 <= on_edge <= 1:
        to_edge = (from_a_x - on_edge * cx) ** 2 + (from_a_y - on_edge * cy) ** 2
    if on_left >= 0:
        to_left = (from_a_x - on_left * left_x) ** 2 + (from_a_y - on_left * left_y) ** 2
    if on_right >= 0:
        to_right = (from_b_x - on_right * right_x) ** 2 + (from_b_y - on_right * right_y) ** 2
    if to_edge <= to_left and to_edge <= to_right:
        return append_line(line, n_lines, ax + r * ty, ay - r * tx, -tx, -ty)
    if to_left <= to_right:
        if left_foreign:
            return n_lines
        return append_line(line, n_lines, ax - r * left_y, ay + r * left_x, left_x, left_y)
    if right_foreign:
        return n_lines
    return append_line(line, n_lines, bx + r * right_y, by - r * right_x, -right_x, -right_y)


@compiled
def append_line(line, n_lines, x, y, direction_x, direction_y):
    """Returns the number of lines."""
    line[n_lines, 0] = x
    line[n_lines, 1] = y
    line[n_lines, 2] = direction_x
    line[n_lines, 3] = direction_y
    return n_lines + 1


@compiled
def append_tangent(line, n_lines, x, y, out_x, out_y, r):
    """The line that touches the circle of radius r around (x, y) in the direction of `out`; returns their number."""
    length = math.sqrt(out_x * out_x + out_y * out_y)
    out_x, out_y = out_x / length, out_y / length
    return append_line(line, n_lines, x + r * out_x, y + r * out_y, out_y, -out_x)


@compiled
def best_on_line(line, i, speed, x, y, farthest):
    """The best velocity on line i, not faster than speed and allowed by all lines before: (found, x, y).

    Best is what is nearest to (x, y) or, with `farthest`, what goes farthest in the direction of (x, y).
    """
    px, py, dx, dy = line[i, 0], line[i, 1], line[i, 2], line[i, 3]
    middle = -(px * dx + py * dy)
    squared = middle * middle + speed * speed - px * px - py * py
    if squared < 0:
        return False, x, y
    half = math.sqrt(squared)
    low, high = middle - half, middle + half
    for j in range(i):
        denominator = det(dx, dy, line[j, 2], line[j, 3])
        numerator = det(line[j, 2], line[j, 3], px - line[j, 0], py - line[j, 1])
        if abs(denominator) <= PARALLEL:
            if numerator < 0:
                return False, x, y
        elif denominator > 0:
            high = min(high, numerator / denominator)
        else:
            low = max(low, numerator / denominator)
        if low > high:
            return False, x, y
    along = min(max(dx * (x - px) + dy * (y - py), low), high)
    if farthest:
        along = high if dx * x + dy * y > 0 else low
    return True, px + along * dx, py + along * dy


@compiled
def best_velocity(line, n_lines, speed, want_x, want_y, farthest):
    """The best velocity under the first n_lines lines: (the line that leaves nothing, or n_lines; x, y).

    Lines are added one by one: where one forbids the best velocity so far, the new one lies on it.
    """
    x, y = want_x, want_y
    if farthest:
        x, y = x * speed, y * speed
    elif x * x + y * y > speed * speed:
        length = math.sqrt(x * x + y * y)
        x, y = speed * x / length, speed * y / length
    for i in range(n_lines):
        if det(line[i, 2], line[i, 3], line[i, 0] - x, line[i, 1] - y) > 0:
            found, new_x, new_y = best_on_line(line, i, speed, want_x, want_y, farthest)
            if not found:
                return i, x, y
            x, y = new_x, new_y
    return n_lines, x, y


@compiled
def least_collision(line, projected, n_walls, n_lines, begin, speed, x, y):
    """In a crowd that leaves no velocity: the one that violates the lines of units least, but none of walls."""
    worst = 0.0
    for i in range(begin, n_lines):
        px, py, dx, dy = line[i, 0], line[i, 1], line[i, 2], line[i, 3]
        if det(dx, dy, px - x, py - y) <= worst:
            continue
        for j in range(n_walls):
            append_line(projected, j, line[j, 0], line[j, 1], line[j, 2], line[j, 3])
        n_projected = n_walls
        for j in range(n_walls, i):  # where lines i and j are violated alike
            qx, qy, other_x, other_y = line[j, 0], line[j, 1], line[j, 2], line[j, 3]
            angle = det(dx, dy, other_x, other_y)
            if abs(angle) > PARALLEL:
                along = det(other_x, other_y, px - qx, py - qy) / angle
                x_alike, y_alike = px + along * dx, py + along * dy
            elif dx * other_x + dy * other_y > 0:
                continue
            else:
                x_alike, y_alike = (px + qx) / 2, (py + qy) / 2
            turn_x, turn_y = other_x - dx, other_y - dy
            length = math.sqrt(turn_x * turn_x + turn_y * turn_y)
            n_projected = append_line(projected, n_projected, x_alike, y_alike, turn_x / length, turn_y / length)
        violated, new_x, new_y = best_velocity(projected, n_projected, speed, -dy, dx, True)
        if violated == n_projected:
            x, y = new_x, new_y
        worst = det(dx, dy, px - x, py - y)
    return x, y


# ---------------------------------------------------------------------------------------------------------------------
# What agents may do and see
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def observe_env(state, config, e):
    """Write the masks, the observations, which refer to them, and the state."""
    unit = state.unit[e]
    for i in range(config.n_allies):
        mask = state.action_mask[e, i]
        mask_agent(unit, i, config.n_allies, state.walkable, mask)
        observe_agent(unit, i, config, mask, state.observations[e, i])
    write_state(unit, config, state.last_action[e], state.action_mask.shape[2], state.state[e])


@compiled
def can_walk(walkable, x, y):
    """Whether the point lies in a cell of the map that units may walk to."""
    return 0 <= x < SIZE and 0 <= y < SIZE and walkable[int(y), int(x)]


@compiled
def mask_agent(unit, i, n_allies, walkable, mask):
    """The actions that agent i may choose."""
    me = unit[i]
    for action in range(len(mask)):
        mask[action] = False
    if me.hp == 0:
        mask[NO_OP] = True
        return
    mask[STOP] = True
    mask[NORTH] = can_walk(walkable, me.x, me.y + MOVE / 2)
    mask[SOUTH] = can_walk(walkable, me.x, me.y - MOVE / 2)
    mask[EAST] = can_walk(walkable, me.x + MOVE / 2, me.y)
    mask[WEST] = can_walk(walkable, me.x - MOVE / 2, me.y)
    first, last = (0, n_allies) if me.heals else (n_allies, len(unit))
    for j in range(first, last):
        other = unit[j]
        fit = other.hp > 0 and not (me.heals and other.heals)
        mask[ATTACK + j - first] = fit and squared_distance(me, other) <= RANGE * RANGE


@compiled
def observe_agent(unit, i, config, mask, out):
    """Moves, enemies, the other allies, the agent itself; all zeros for the dead."""
    me, n_allies = unit[i], config.n_allies
    if me.hp == 0:
        for k in range(len(out)):
            out[k] = 0
        return
    for k in range(4):
        out[k] = mask[NORTH + k]
    k = 4
    for j in range(n_allies, len(unit)):
        seen = mask[ATTACK + j - n_allies]
        k = observe_unit(me, unit[j], seen, config.enemy_shields, config.n_types, out, k)
    for j in range(n_allies):
        if j != i:
            k = observe_unit(me, unit[j], True, config.ally_shields, config.n_types, out, k)
    out[k] = me.hp / me.max_hp
    k += 1
    if config.ally_shields:
        out[k] = me.shield / max(me.max_shield, 1)
        k += 1
    write_type(me, config.n_types, out, k)


@compiled
def observe_unit(me, other, flag, shields, n_types, out, k):
    """Write what a unit sees of another one, beginning at out[k]: zeros beyond its sight. Returns the end."""
    across, up = other.x - me.x, other.y - me.y
    squared = across * across + up * up
    if other.hp > 0 and squared < SIGHT * SIGHT:
        out[k] = flag
        out[k + 1] = math.sqrt(squared) / SIGHT
        out[k + 2] = across / SIGHT
        out[k + 3] = up / SIGHT
        out[k + 4] = other.hp / other.max_hp
        k += 5
        if shields:
            out[k] = other.shield / max(other.max_shield, 1)  # units beside it may have none
            k += 1
        return write_type(other, n_types, out, k)
    end = k + 5 + shields + n_types
    while k < end:
        out[k] = 0
        k += 1
    return end


@compiled
def write_type(me, n_types, out, k):
    """The bits for the type; returns the end."""
    for bit in range(n_types):
        out[k + bit] = bit == me.type_bit
    return k + n_types


@compiled
def write_state(unit, config, last_action, n_actions, out):
    """Allies, enemies, last actions."""
    k = 0
    for i in range(len(unit)):
        me, ally = unit[i], i < config.n_allies
        shields = config.ally_shields if ally else config.enemy_shields
        if me.hp == 0:
            end = k + 3 + ally + shields + config.n_types
            while k < end:
                out[k] = 0
                k += 1
            continue
        out[k] = me.hp / me.max_hp
        k += 1
        if ally:
            out[k] = me.energy / MOST_ENERGY if me.heals else me.cooldown / me.cooldown_scale
            k += 1
        out[k] = (me.x - SIZE / 2) / SIZE
        out[k + 1] = (me.y - SIZE / 2) / SIZE
        k += 2
        if shields:
            out[k] = me.shield / max(me.max_shield, 1)
            k += 1
        k = write_type(me, config.n_types, out, k)
    for i in range(config.n_allies):
        for action in range(n_actions):
            out[k] = action == last_action[i]
            k += 1


@compiled
def reset_all(state, config, mask, seed, episodes):
    for e in range(len(mask)):
        if mask[e]:
            state.random[e] = episode_state(seed, e, episodes[e])
            reset_env(state, config, e)
            observe_env(state, config, e)


@compiled
def step_all(state, config, actions, playing):
    refused = forbidden_action(actions, state.action_mask)
    if refused >= 0:
        return refused
    for e in range(len(playing)):
        if playing[e]:
            step_env(state, config, e, actions)
            observe_env(state, config, e)
    return -1


class Env(vector.VectorEnv):
    """A battle; see the module's docstring."""

    can_draw = True

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool, *, map_name: str, rule_set: str) -> None:
        """map_name, rule_set: keys of the tables in `envs.smaclite_maps`."""
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
        """The map of one sub-environment: units as discs with the letter of their type, allies blue, enemies red.

        Above a unit are bars of its hp (green) and its shield (blue); those that fly have a white edge. Lines join a
        unit to whom it has hit, or with a green one healed, in this step. Crosses are the dead.
        """
        from envs import render  # Pillow is needed only where something is drawn

        rows, columns = np.nonzero(self.game.walkable)
        bottom, top = max(rows.min() - 1, 0), min(rows.max() + 2, SIZE)
        left, right = max(columns.min() - 1, 0), min(columns.max() + 2, SIZE)
        cell, margin, caption = 640 // max(top - bottom, right - left), 10, 34
        width, height = (right - left) * cell, (top - bottom) * cell
        canvas = render.Canvas(width + 2 * margin, height + margin + caption)

        def place(x: float, y: float) -> tuple[float, float]:
            return margin + (x - left) * cell, caption + (top - y) * cell

        def polygon(corners: Polygon, colour: render.Colour) -> None:
            points = [place(*corner) for corner in corners]
            canvas.pen.polygon([(x * render.DETAIL, y * render.DETAIL) for x, y in points], fill=colour)

        canvas.text(margin, caption / 2, f"step {self.game.steps[index]} / {self.episode_limit}", 15, anchor="lm")
        canvas.text(margin + width / 2, caption / 2, self.name, 15)
        canvas.text(margin + width, caption / 2, f"return {self.game.score[index]:.2f}", 15, anchor="rm")
        for wall in self.walls:
            polygon([(min(max(x, left), right), min(max(y, bottom), top)) for x, y in wall], WALL)

        units = self.game.unit[index]
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


def edges_of(wall: Polygon) -> list[tuple[float, ...]]:
    """Records of the kind EDGE."""
    corners = np.array(wall, float)
    ends = np.roll(corners, -1, axis=0)
    directions = (ends - corners) / np.linalg.norm(ends - corners, axis=1, keepdims=True)
    before, after = np.roll(directions, 1, axis=0), np.roll(directions, -1, axis=0)
    box = np.tile([*corners.min(axis=0), *corners.max(axis=0)], (len(wall), 1))
    return [tuple(row) for row in np.hstack([corners, ends, directions, before, after, box])]


def edges_near_cells(edge: Any, distance: float) -> NDArray[np.int64]:
    """For each cell, [row, column], the edges of walls nearer than the distance; then -1."""
    low = np.arange(SIZE)[:, None]
    across = np.maximum(0, np.maximum(edge.left - low - 1, low - edge.right))  # [column, edge]
    up = np.maximum(0, np.maximum(edge.bottom - low - 1, low - edge.top))  # [row, edge]
    near = up[:, None] ** 2 + across[None] ** 2 < distance**2  # [row, column, edge]
    numbers = np.full((SIZE, SIZE, max(near.sum(axis=2).max(initial=0), 1)), -1)
    for row in range(SIZE):
        for column in range(SIZE):
            found = np.flatnonzero(near[row, column])
            numbers[row, column, : len(found)] = found
    return numbers
