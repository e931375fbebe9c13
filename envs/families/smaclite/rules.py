"""The rules of a battle, and the loops that play them; the package's docstring has them in words."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs.families.kernels import compiled, episode_state, forbidden_action, random_below
from envs.families.smaclite.maps import MELEE, SIZE
from envs.families.smaclite.walking import TICK, avoid_collisions, det, squared_distance

NO_OP, STOP, NORTH, SOUTH, EAST, WEST, ATTACK = 0, 1, 2, 3, 4, 5, 6  # ATTACK + k: unit k
TICKS = 8  # of a step
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
PLACES = 16  # around a unit, for melee units that attack it
CIRCLE = np.array([(math.cos(k * math.tau / PLACES), math.sin(k * math.tau / PLACES)) for k in range(PLACES)])
NOWHERE, UNKNOWN = -1, -1  # no place; places that nobody has looked at yet
LARGEST_TURN = -0.5  # cosine of the angle by which a unit leaves its way at most, 120 degrees; else it waits
FAR = 1e6  # more than any squared distance
SECOND_CHOICE = 1e7  # more than FAR


UNIT = np.dtype(
    [
        # What its type says; see `maps.Unit`
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
        ("place", int),  # around its target, to which a melee unit walks, or NOWHERE
        ("room", int),  # bit k: the place k around it is free for melee units of the other side; or UNKNOWN
        ("side", int),  # on which it passes who stands in its way: 1 left, -1 right, 0 nobody does
        ("fires", bool),  # its target is within its reach
        ("shot", int),  # whom it hit or healed last in this step, or NOBODY
    ],
    align=True,
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
    edge: Any  # [edge] of all walls, records of the kind `walking.EDGE`
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
    """What the name says: the fields of `maps.Rules`, and numbers of the map.

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
    surrounds: bool

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
        me.place, me.side = NOWHERE, 0
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
        unit[i].shot, unit[i].place = NOBODY, NOWHERE

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
            keep = me.place != NOWHERE or unit[me.target].target == i or within_reach(me, unit[me.target])
            if unit[me.target].hp == 0 or (i >= n_allies and (me.looks_around or not keep)):
                me.target, me.place = NOBODY, NOWHERE
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
    if config.surrounds:
        surround(unit, n_allies, state.near, state.line)
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
# Surrounding
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def surround(unit, n_allies, standing, close):
    """Melee units whose target is out of reach walk to a free place around it, and on their way around who stands.

    standing, close: room for the numbers of the units that stand, and for the directions of some of them.
    """
    n_standing = 0
    for i in range(len(unit)):
        me = unit[i]
        me.room = UNKNOWN
        if me.hp > 0 and not me.flies and me.wanted_x == 0 and me.wanted_y == 0:
            standing[n_standing] = i
            n_standing += 1
    for i in range(len(unit)):
        me = unit[i]
        if me.hp == 0 or me.reach >= MELEE:
            continue
        if me.target == NOBODY or me.fires:
            me.place, me.side = NOWHERE, 0
            continue
        if me.place == NOWHERE:
            choose_place(unit, i, n_allies, standing, n_standing)
        if me.place != NOWHERE:
            walk_to_place(unit, me, standing, n_standing, close)


@compiled
def distance_of_places(me, other):
    """Of the places around another unit, from its centre: where this unit has it well within its reach."""
    return me.radius + other.radius + me.reach / 2


@compiled
def choose_place(unit, i, n_allies, standing, n_standing):
    """The nearest free place: for an enemy around anybody in its sight, whom it then attacks, else around its target.

    Without any, the unit keeps its target and walks straight to it.
    """
    me = unit[i]
    target = me.target
    least = FAR
    for n in range(n_allies if i >= n_allies else 1):
        j = target if n == 0 else n - 1 if n <= target else n  # the target first, since it is near
        other = unit[j]
        to_x, to_y = other.x - me.x, other.y - me.y
        squared = to_x * to_x + to_y * to_y
        sight = me.sight + other.radius
        if other.hp == 0 or other.flies or (j != target and squared >= sight * sight):
            continue
        distance = distance_of_places(me, other)
        nearest = math.sqrt(least) + distance
        if squared >= nearest * nearest:
            continue
        if other.room == UNKNOWN:
            look_for_room(unit, j, me.body, distance, standing, n_standing)
        for place in range(PLACES):
            if other.room >> place & 1:
                x, y = to_x + distance * CIRCLE[place, 0], to_y + distance * CIRCLE[place, 1]
                if x * x + y * y < least:
                    least = x * x + y * y
                    me.target, me.place = j, place


@compiled
def look_for_room(unit, j, body, distance, standing, n_standing):
    """Note which places around unit j are free: there a melee unit touches nobody who stands.

    All melee units of the other side are alike: such a body, and so far from the centre.
    """
    me = unit[j]
    me.room = (1 << PLACES) - 1
    for n in range(n_standing):
        other = unit[standing[n]]
        touch = body + other.body
        x, y = other.x - me.x, other.y - me.y
        squared = x * x + y * y
        if standing[n] == j or squared > (distance + touch) * (distance + touch):
            continue
        ahead = (squared + distance * distance - touch * touch) / 2  # by the law of cosines
        for place in range(PLACES):
            if distance * (x * CIRCLE[place, 0] + y * CIRCLE[place, 1]) > ahead:
                me.room &= ~(1 << place)


@compiled
def walk_to_place(unit, me, standing, n_standing, close):
    """Straight or, where somebody close stands in the way, past those who do, with the smallest turn.

    A unit stays on its side until its way is free.
    """
    other = unit[me.target]
    distance = distance_of_places(me, other)
    ahead_x = other.x - me.x + distance * CIRCLE[me.place, 0]
    ahead_y = other.y - me.y + distance * CIRCLE[me.place, 1]
    length = max(math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y), 1e-9)
    ahead_x, ahead_y = ahead_x / length, ahead_y / length
    n_close = 0
    for n in range(n_standing):
        other = unit[standing[n]]
        to_x, to_y = other.x - me.x, other.y - me.y
        squared = to_x * to_x + to_y * to_y
        touch = me.body + other.body + me.reach
        if squared < touch * touch:
            length = max(math.sqrt(squared), 1e-9)
            close[n_close, 0], close[n_close, 1] = to_x / length, to_y / length
            n_close += 1

    x, y = ahead_x, ahead_y
    side = 0
    if comes_nearer(close, n_close, ahead_x, ahead_y):
        most = LARGEST_TURN
        for n in range(n_close):
            for left in (1, -1):
                try_x, try_y = -left * close[n, 1], left * close[n, 0]
                along = try_x * ahead_x + try_y * ahead_y
                turns_left = det(ahead_x, ahead_y, try_x, try_y) >= 0
                if along <= most or turns_left != (left == 1) or me.side == -left:
                    continue
                if not comes_nearer(close, n_close, try_x, try_y):
                    most = along
                    x, y = try_x, try_y
                    side = left
    me.side = side
    me.wanted_x, me.wanted_y = me.speed * x, me.speed * y


@compiled
def comes_nearer(close, n_close, x, y):
    """Whether a step in the direction (x, y) leads nearer to any of those in these directions."""
    nearer = False
    for n in range(n_close):
        nearer |= x * close[n, 0] + y * close[n, 1] > 1e-9
    return nearer


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
