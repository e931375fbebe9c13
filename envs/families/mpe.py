"""The multi-agent particle environments (Lowe et al., 2017; Papoudakis et al., 2021): discs that move in a plane.

    mpe-speaker-listener  mpe-spread  mpe-adversary[-selfplay]  mpe-tag[-selfplay]       the paper's game
    mpe2-speaker-listener  ...                                                           that of the package mpe2

Speaker-Listener  The speaker (agent 0) sees which of three landmarks is the goal and says one of three symbols; the
                  listener (agent 1) hears it and should go there.
Spread            Three agents should cover three landmarks without touching each other.
Adversary         Two good agents (1 and 2) know which of two landmarks is the goal; one of them should be near it.
                  The adversary (0) wants to be near it too, but has to guess which it is from what they do.
Tag               Three predators (0 to 2) chase a prey (3), which is faster. Two large landmarks stand in the way.

In Adversary and Tag the agents learn that the paper's tasks control, the good agents or the predators, numbered from 0;
the adversary and the prey are built-in opponents. With -selfplay all agents learn, in the order above: the good agents
and the predators are team 0, the adversary and the prey team 1.

Actions: 0 nothing; 1 and 2 a force along x, to the right and to the left; 3 and 4 along y, up and down. In mpe2-...
1 and 2 change places, and so do 3 and 4. The speaker does not move: its actions 0, 1, 2 are the symbols, and the mask
forbids 3 and 4. Everything else is always allowed.

Motion, with time steps of 0.1: a force F changes a velocity v to 0.75 v + 0.1 F, cut to the agent's top speed; then the
agent moves by 0.1 v. (In mpe2-... it moves first, with its old velocity.) Acting is a force of 5; in Tag it is 3 for
predators, whose top speed is 1, and 4 for the prey, whose top speed is 1.3. The agents of Spread and Tag push each
other away, and so do the landmarks of Tag: with 100 times the depth to which two discs overlap, softened at the edge.
Two discs touch where their centres are nearer than the sum of their radii. The plane has no border.
    radius of an agent      0.15 in Spread and Adversary, 0.075 in Speaker-Listener and of predators, 0.05 of the prey
    radius of a landmark    0.05 in Spread, 0.08 in Adversary, 0.04 in Speaker-Listener, 0.2 in Tag

Observations; "where" is (x, y) seen from the agent, velocities and positions are (x, y) too, and other agents come in
their order. Shorter ones are filled up with zeros. State: the observations of all learning agents, one after the other.
    speaker     for each landmark: 0.65 if it is the goal, else 0.15                                         3 values
    listener    velocity; where the landmarks are; the symbol said in the last step, one-hot (zeros
                before the first)                                                                           11
    Spread      velocity; position; where the landmarks are; where the others are; four zeros               18
    good agent  where the goal is; where the landmarks are; where the others are                            10
    adversary   where the landmarks are; where the others are                                                8
    predator    velocity; position; where the landmarks are; where the others are; the prey's velocity      16
    prey        velocity; position; where the landmarks are; where the others are                           14

Rewards of a step, d being a distance after it; the team's reward is the mean over team 0.
    Speaker-Listener    - 2 d(listener, goal)^2 for both: each agent's - d^2, summed over the agents
    Spread              for each agent the sum over the agents of - D - 1 - (its contacts); D: sum over the landmarks of
                        the distance to the nearest agent; the 1 is the contact with itself in the paper's code
    Adversary           good agents d(adversary, goal) - d(nearest good agent, goal); adversary - d(adversary, goal)^2
    Tag                 each predator 10 for every predator that touches the prey; the prey minus this, and minus a
                        penalty for each coordinate x: 10 (|x| - 0.9) from 0.9 on, from 1 on exp(2 |x| - 2), at most 10
    mpe2-...            Speaker-Listener - d^2; Spread for each agent (- D - its contacts) / 2; adversary - d
End: step 25, a truncation.

Start: nothing moves; agents and landmarks are uniform in the square from -1 to 1, the landmarks of Tag in that from
-0.9 to 0.9; every landmark is equally likely to be the goal.

Statistics: goal_distance, of the listener or of the nearest good agent, and adversary_distance, from the goal to the
adversary, both at the end; occupied_landmarks, those with an agent within 0.1 at the end; contacts, the pairs of agents
(in Tag: predators with the prey) that touch, added up over the steps.

Opponents: networks that tools/train_opponents.py has trained with the learning team in the paper's -selfplay task
and that always take the most probable action. Like every agent, an opponent decides before it knows what the others do
in the same step: it acts on the observation that the last step (or the reset) has left. mpe2-... has the same
opponents, their moves translated. The files opponents/*.json say where they come from. With
env_kwargs="opponent='<file>'" the network in that file plays instead: an archive of NumPy arrays named as in `Network`.
"""

from __future__ import annotations

import hashlib
import os
from math import exp, log1p, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families import OPPONENTS
from envs.families.kernels import WEYL, compiled, episode_state, forbidden_action, mix, random_below, wrapping

EPISODE_LIMIT = 25
SPEAKER_LISTENER, SPREAD, ADVERSARY, TAG = range(4)
SPEAKER = 0  # the other agent is the listener
PREY = 3  # the agents before it are the predators

# The physics
TIME_STEP = 0.1
DAMPING = 0.25
CONTACT_FORCE, CONTACT_MARGIN = 100.0, 0.001
OCCUPIED = 0.1  # a landmark is occupied by an agent nearer than this
FAR_APART = 40  # margins between two discs from which on their force, below 1e-18, is left out
GOAL_COLOUR, OTHER_COLOUR = 0.65, 0.15  # what the speaker sees of the goal and of the other landmarks


class State(NamedTuple):
    """One game per entry of the leading axis. Agents are all that move, those of a built-in opponent too."""

    random: NDArray[np.uint64]  # [env] the generator's state
    steps: NDArray[np.int64]  # [env]
    score: NDArray[np.float64]  # [env] the team's return so far
    agent_position: NDArray[np.float64]  # [env, agent, (x, y)]
    agent_velocity: NDArray[np.float64]  # [env, agent, (x, y)]
    landmark_position: NDArray[np.float64]  # [env, landmark, (x, y)]
    goal: NDArray[np.int64]  # [env] the landmark that is the goal; -1: the scenario has none
    symbol: NDArray[np.int64]  # [env] what the speaker said in this step; -1: nothing yet
    force: NDArray[np.float64]  # [env, agent, (x, y)] on each agent in this step
    own_rewards: NDArray[np.float64]  # [env, agent] of this step
    opponent_action: NDArray[np.int64]  # [env] what the built-in opponent does in the next step
    views: NDArray[np.float32]  # [env, agent, value] what each agent sees; if all learn, these are the observations
    contacts: NDArray[np.float32]  # [env] pairs of agents that touch, counted in every step of the episode
    occupied_landmarks: NDArray[np.float32]  # [env] landmarks with an agent on them, at present
    goal_distance: NDArray[np.float32]  # [env] from the goal to the listener, or to the nearest good agent
    adversary_distance: NDArray[np.float32]  # [env] from the goal to the adversary
    observations: NDArray[np.float32]  # [env, learning agent, value]
    agent_rewards: NDArray[np.float32]  # [env, learning agent]
    rewards: NDArray[np.float32]  # [env]
    truncated: NDArray[np.bool_]  # [env]


class Config(NamedTuple):
    """What the name says. The last six are all in which the paper's game and that of the package mpe2 differ."""

    scenario: int
    opponent: int  # the agent that a built-in opponent steers; -1: none
    first: int  # the first agent that learns
    team_first: int  # the first agent of team 0
    team_size: int
    radius: NDArray[np.float64]  # [agent]
    acceleration: NDArray[np.float64]  # [agent]
    top_speed: NDArray[np.float64]  # [agent]
    landmark_radius: float
    landmark_range: float  # landmarks start between minus and plus this
    velocity_first: bool  # an agent moves with its new velocity, not with the one before the step
    direction: float  # of actions 1 and 3: 1 towards larger coordinates, -1 towards smaller ones
    squared: bool  # the adversary's distance counts squared in its own reward
    summed: bool  # in the scenarios that all agents share, each receives the sum of their rewards
    self_contact: bool  # in spread each agent also touches itself
    share: float  # in spread the rewards count this much


@wrapping
@compiled
def random_between(random, e, low, high):
    """A uniform number from low to high from the generator of sub-environment e."""
    random[e] += WEYL
    return low + (high - low) * (np.float64(mix(random[e]) >> np.uint64(11)) * 2.0**-53)


@compiled
def reset_env(state, config, e):
    """Place agents and landmarks; choose the goal."""
    n_agents, n_landmarks = state.agent_position.shape[1], state.landmark_position.shape[1]
    state.steps[e] = 0
    state.score[e] = 0
    state.symbol[e] = -1
    state.contacts[e] = 0
    state.goal[e] = -1
    if config.scenario in (SPEAKER_LISTENER, ADVERSARY):
        state.goal[e] = random_below(state.random, e, n_landmarks)
    for i in range(n_agents):
        for x in range(2):
            state.agent_position[e, i, x] = random_between(state.random, e, -1.0, 1.0)
            state.agent_velocity[e, i, x] = 0
    for k in range(n_landmarks):
        for x in range(2):
            reach = config.landmark_range
            state.landmark_position[e, k, x] = random_between(state.random, e, -reach, reach)


@compiled
def distance(a, b, e, i, j):
    """Between place i of a and place j of b, arrays [env, place, (x, y)].

    i and j are always variables: Numba would compile this rule, and what contains it, once more for each constant.
    """
    dx, dy = a[e, i, 0] - b[e, j, 0], a[e, i, 1] - b[e, j, 1]
    return sqrt(dx * dx + dy * dy)


@compiled
def repulsion(dx, dy, reach):
    """Force on a disc that lies (dx, dy) from another, divided by that distance; reach: the sum of their radii.

    It grows with the depth to which the discs overlap, softly: margin ln(1 + exp(depth / margin)).
    """
    square = dx * dx + dy * dy
    farthest = reach + FAR_APART * CONTACT_MARGIN
    if square > farthest * farthest or square == 0:  # on the same spot there is no direction to push to
        return 0.0
    apart = sqrt(square)
    depth = (reach - apart) / CONTACT_MARGIN
    return CONTACT_FORCE * CONTACT_MARGIN * (max(depth, 0.0) + log1p(exp(-abs(depth)))) / apart


@compiled
def act_env(state, config, e, actions):
    """Let all agents act: a force on each, and the speaker's symbol. The opponent's moves are always the paper's."""
    state.steps[e] += 1
    state.truncated[e] = state.steps[e] == EPISODE_LIMIT
    for i in range(state.agent_position.shape[1]):
        if i == config.opponent:
            action, push = state.opponent_action[e], config.acceleration[i]
        else:
            action, push = actions[e, i - config.first], config.acceleration[i] * config.direction
        state.force[e, i, 0] = push * (action == 1) - push * (action == 2)
        state.force[e, i, 1] = push * (action == 3) - push * (action == 4)
        if config.scenario == SPEAKER_LISTENER and i == SPEAKER:
            state.symbol[e] = action


@compiled
def move_env(state, config, e):
    """Add the repulsion of discs that collide to the agents' own forces; then integrate."""
    position, velocity, force, landmark = (
        state.agent_position,
        state.agent_velocity,
        state.force,
        state.landmark_position,
    )
    n_agents, n_landmarks = position.shape[1], landmark.shape[1]
    if config.scenario in (SPREAD, TAG):
        for i in range(n_agents):
            for j in range(i):
                dx, dy = position[e, i, 0] - position[e, j, 0], position[e, i, 1] - position[e, j, 1]
                push = repulsion(dx, dy, config.radius[i] + config.radius[j])
                force[e, i, 0] += push * dx
                force[e, i, 1] += push * dy
                force[e, j, 0] -= push * dx
                force[e, j, 1] -= push * dy
    if config.scenario == TAG:
        for i in range(n_agents):
            for k in range(n_landmarks):
                dx, dy = position[e, i, 0] - landmark[e, k, 0], position[e, i, 1] - landmark[e, k, 1]
                push = repulsion(dx, dy, config.radius[i] + config.landmark_radius)
                force[e, i, 0] += push * dx
                force[e, i, 1] += push * dy

    for i in range(n_agents):
        x, y = velocity[e, i, 0], velocity[e, i, 1]
        if not config.velocity_first:
            position[e, i, 0] += x * TIME_STEP
            position[e, i, 1] += y * TIME_STEP
        x = (1 - DAMPING) * x + TIME_STEP * force[e, i, 0]
        y = (1 - DAMPING) * y + TIME_STEP * force[e, i, 1]
        speed = sqrt(x * x + y * y)
        if speed > config.top_speed[i]:
            x *= config.top_speed[i] / speed
            y *= config.top_speed[i] / speed
        velocity[e, i, 0] = x
        velocity[e, i, 1] = y
        if config.velocity_first:
            position[e, i, 0] += x * TIME_STEP
            position[e, i, 1] += y * TIME_STEP


@compiled
def reward_speaker_listener(state, config, e):
    """Minus the listener's squared distance to the goal, for both."""
    listener = state.agent_position.shape[1] - 1
    apart = distance(state.agent_position, state.landmark_position, e, listener, state.goal[e])
    state.goal_distance[e] = apart
    for i in range(listener + 1):
        state.own_rewards[e, i] = -apart * apart


@compiled
def reward_spread(state, config, e):
    """Minus every landmark's distance to its nearest agent, minus one for each contact of the agent."""
    position, landmark, own = state.agent_position, state.landmark_position, state.own_rewards
    n_agents, n_landmarks = position.shape[1], landmark.shape[1]
    uncovered = 0.0
    occupied = 0
    for k in range(n_landmarks):
        nearest = np.inf
        for i in range(n_agents):
            nearest = min(nearest, distance(position, landmark, e, i, k))
        uncovered += nearest
        occupied += nearest < OCCUPIED
    state.occupied_landmarks[e] = occupied
    for i in range(n_agents):
        own[e, i] = -uncovered - config.self_contact
        for j in range(i):
            if distance(position, position, e, i, j) < config.radius[i] + config.radius[j]:
                state.contacts[e] += 1
                own[e, i] -= 1
                own[e, j] -= 1
    for i in range(n_agents):
        own[e, i] *= config.share


@compiled
def reward_adversary(state, config, e):
    """Good agents: the adversary's distance to the goal minus that of the nearest of them. Adversary: minus its own."""
    n_agents, own = state.agent_position.shape[1], state.own_rewards
    theirs = 0.0
    nearest = np.inf
    for i in range(n_agents):
        apart = distance(state.agent_position, state.landmark_position, e, i, state.goal[e])
        if i == 0:
            theirs = apart
        else:
            nearest = min(nearest, apart)
    state.adversary_distance[e] = theirs
    state.goal_distance[e] = nearest
    own[e, 0] = -theirs * theirs if config.squared else -theirs
    for i in range(1, n_agents):
        own[e, i] = theirs - nearest


@compiled
def reward_tag(state, config, e):
    """Each predator: 10 for every predator that touches the prey. Prey: minus that, and a penalty for running away."""
    position, own = state.agent_position, state.own_rewards
    prey = position.shape[1] - 1
    caught = 0
    for i in range(prey):
        caught += distance(position, position, e, i, prey) < config.radius[i] + config.radius[prey]
    state.contacts[e] += caught
    for i in range(prey):
        own[e, i] = 10 * caught
    own[e, prey] = -10 * caught
    for x in range(2):
        away = abs(position[e, prey, x])
        if away >= 1:
            own[e, prey] -= min(exp(2 * away - 2), 10.0)
        elif away >= 0.9:
            own[e, prey] -= 10 * (away - 0.9)


@compiled
def reward_env(state, config, e):
    """Each agent's reward, and the team's: the mean over team 0."""
    n_agents, n_learning, own = state.own_rewards.shape[1], state.agent_rewards.shape[1], state.own_rewards
    if config.scenario == SPEAKER_LISTENER:
        reward_speaker_listener(state, config, e)
    elif config.scenario == SPREAD:
        reward_spread(state, config, e)
    elif config.scenario == ADVERSARY:
        reward_adversary(state, config, e)
    else:
        reward_tag(state, config, e)
    if config.summed and config.scenario in (SPEAKER_LISTENER, SPREAD):
        total = 0.0
        for i in range(n_agents):
            total += own[e, i]
        for i in range(n_agents):
            own[e, i] = total
    for i in range(n_learning):
        state.agent_rewards[e, i] = own[e, config.first + i]
    team_reward = 0.0
    for i in range(config.team_first, config.team_first + config.team_size):
        team_reward += own[e, i] / config.team_size
    state.rewards[e] = team_reward
    state.score[e] += team_reward


@compiled
def observe_env(state, config, e):
    """Write what each agent sees; values that it does not have stay zero."""
    views, position, velocity, landmark = (
        state.views,
        state.agent_position,
        state.agent_velocity,
        state.landmark_position,
    )
    scenario, goal = config.scenario, state.goal[e]
    n_agents, n_landmarks = position.shape[1], landmark.shape[1]
    for i in range(n_agents):
        if scenario == SPEAKER_LISTENER and i == SPEAKER:
            for k in range(n_landmarks):
                views[e, i, k] = GOAL_COLOUR if k == goal else OTHER_COLOUR
            continue
        x, y = position[e, i, 0], position[e, i, 1]
        n = 0
        if scenario != ADVERSARY:
            views[e, i, 0] = velocity[e, i, 0]
            views[e, i, 1] = velocity[e, i, 1]
            n = 2
        elif i > 0:
            views[e, i, 0] = landmark[e, goal, 0] - x
            views[e, i, 1] = landmark[e, goal, 1] - y
            n = 2
        if scenario in (SPREAD, TAG):
            views[e, i, 2] = x
            views[e, i, 3] = y
            n = 4
        for k in range(n_landmarks):
            views[e, i, n] = landmark[e, k, 0] - x
            views[e, i, n + 1] = landmark[e, k, 1] - y
            n += 2
        if scenario == SPEAKER_LISTENER:
            for k in range(n_landmarks):
                views[e, i, n + k] = state.symbol[e] == k
            continue
        for j in range(n_agents):
            if j != i:
                views[e, i, n] = position[e, j, 0] - x
                views[e, i, n + 1] = position[e, j, 1] - y
                n += 2
        if scenario == TAG and i != PREY:
            views[e, i, n] = velocity[e, PREY, 0]
            views[e, i, n + 1] = velocity[e, PREY, 1]
    if config.opponent >= 0:
        for i in range(state.observations.shape[1]):
            for n in range(state.observations.shape[2]):
                state.observations[e, i, n] = views[e, config.first + i, n]


# ---------------------------------------------------------------------------------------------------------------------
# The loops take State and Config as plain tuples, as in lbf.py.
# ---------------------------------------------------------------------------------------------------------------------


@compiled
def reset_all(arrays, numbers, mask, seed, episodes):
    state, config = State(*arrays), Config(*numbers)
    for e in range(len(mask)):
        if mask[e]:
            state.random[e] = episode_state(seed, e, episodes[e])
            reset_env(state, config, e)
            observe_env(state, config, e)


@compiled
def step_all(arrays, numbers, action_mask, actions, playing):
    refused = forbidden_action(actions, action_mask)
    if refused >= 0:
        return refused
    state, config = State(*arrays), Config(*numbers)
    for e in range(len(playing)):
        if playing[e]:
            act_env(state, config, e, actions)
            move_env(state, config, e)
            reward_env(state, config, e)
            observe_env(state, config, e)
    return -1


# ---------------------------------------------------------------------------------------------------------------------
# Built-in opponents
# ---------------------------------------------------------------------------------------------------------------------


class Network(NamedTuple):
    """An opponent: Linear - ReLU - Linear - ReLU - Linear, as algos/maddpg.py trains it with --network fc; float32."""

    first_weight: NDArray[np.float32]  # [value, hidden]
    first_bias: NDArray[np.float32]
    core_weight: NDArray[np.float32]  # [hidden, hidden]
    core_bias: NDArray[np.float32]
    last_weight: NDArray[np.float32]  # [hidden, action]
    last_bias: NDArray[np.float32]


def read_network(path: str | os.PathLike[str], scenario: str) -> Network:
    """The network in an archive of six arrays, named as in `Network`, as tools/train_opponents.py writes it.

    Raises InputError where the file is missing or damaged, and where the network does not fit the scenario's opponent.
    """
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise ValueError("a pipe, for example, which may never end")
        with np.load(path) as arrays:
            network = Network(*(np.ascontiguousarray(arrays[name], np.float32) for name in Network._fields))
    except FileNotFoundError:
        raise vector.InputError(
            f"there is no opponent's file {str(path)!r}. Results name a network by its contents, `env_kwargs` by its "
            "file."
        ) from None
    except OSError as error:
        raise vector.InputError(f"the opponent's file cannot be read: {error}.") from None
    except Exception:  # NumPy and zipfile raise almost anything on a damaged file
        raise vector.InputError(f"{str(path)!r} is not the file of an opponent's network, or is damaged.") from None
    game, hidden = SCENARIOS[scenario], network.first_bias.shape
    fitting = [(game.obs_size, *hidden), hidden, hidden * 2, hidden, (*hidden, 5), (5,)]
    shapes = [array.shape for array in network]
    if shapes != fitting or not all(np.isfinite(array).all() for array in network):
        raise vector.InputError(
            f"{str(path)!r} is no opponent for {scenario}: its network must be finite and lead from {game.obs_size} "
            f"values to 5 actions over two equal hidden layers; its arrays are {', '.join(map(str, shapes))}."
        )
    return network


def fingerprint(network: Network) -> str:
    """16 hexadecimal digits that name a network by its weights, whatever file they come from."""
    return hashlib.sha256(b"".join(array.tobytes() for array in network)).hexdigest()[:16]


@compiled
def linear(weight, bias, values, outputs):
    """outputs = values @ weight + bias, without the many products that a ReLU has made zero."""
    for j in range(len(outputs)):
        outputs[j] = bias[j]
    for k in range(len(values)):
        value = values[k]
        if value != 0:
            for j in range(len(outputs)):
                outputs[j] += value * weight[k, j]


@compiled
def rectify(values):
    for j in range(len(values)):
        values[j] = max(values[j], np.float32(0))


@compiled
def decide_all(
    first_weight, first_bias, core_weight, core_bias, last_weight, last_bias,
    first, core, last,
    views, opponent, opponent_action, playing,
):  # fmt: skip
    """The most probable action of the opponent in each sub-environment. first, core, last: room for the layers."""
    for e in range(len(playing)):
        if playing[e]:
            linear(first_weight, first_bias, views[e, opponent], first)
            rectify(first)
            linear(core_weight, core_bias, first, core)
            rectify(core)
            linear(last_weight, last_bias, core, last)
            opponent_action[e] = np.argmax(last)


# ---------------------------------------------------------------------------------------------------------------------
# The environment
# ---------------------------------------------------------------------------------------------------------------------


class Scenario(NamedTuple):
    """What an environment is built from: one of the four games, the same in both packages."""

    number: int
    landmarks: int
    obs_size: int  # of the agent that sees most
    n_actions: tuple[int, ...]  # [agent]
    teams: tuple[int, ...]  # [agent]
    kinds: tuple[str, ...]  # [agent]: the names that mpe2 gives them
    radius: tuple[float, ...]  # [agent]
    acceleration: tuple[float, ...]  # [agent]; 0: it cannot move
    top_speed: tuple[float, ...]  # [agent]
    landmark_radius: float
    landmark_range: float
    statistics: tuple[str, ...]


SCENARIOS = {
    "speaker-listener": Scenario(
        number=SPEAKER_LISTENER,
        landmarks=3,
        obs_size=11,
        n_actions=(3, 5),
        teams=(0, 0),
        kinds=("speaker", "listener"),
        radius=(0.075, 0.075),
        acceleration=(0.0, 5.0),
        top_speed=(np.inf, np.inf),
        landmark_radius=0.04,
        landmark_range=1.0,
        statistics=("goal_distance",),
    ),
    "spread": Scenario(
        number=SPREAD,
        landmarks=3,
        obs_size=18,
        n_actions=(5, 5, 5),
        teams=(0, 0, 0),
        kinds=("agent", "agent", "agent"),
        radius=(0.15, 0.15, 0.15),
        acceleration=(5.0, 5.0, 5.0),
        top_speed=(np.inf, np.inf, np.inf),
        landmark_radius=0.05,
        landmark_range=1.0,
        statistics=("contacts", "occupied_landmarks"),
    ),
    "adversary": Scenario(
        number=ADVERSARY,
        landmarks=2,
        obs_size=10,
        n_actions=(5, 5, 5),
        teams=(1, 0, 0),
        kinds=("adversary", "agent", "agent"),
        radius=(0.15, 0.15, 0.15),
        acceleration=(5.0, 5.0, 5.0),
        top_speed=(np.inf, np.inf, np.inf),
        landmark_radius=0.08,
        landmark_range=1.0,
        statistics=("goal_distance", "adversary_distance"),
    ),
    "tag": Scenario(
        number=TAG,
        landmarks=2,
        obs_size=16,
        n_actions=(5, 5, 5, 5),
        teams=(0, 0, 0, 1),
        kinds=("adversary", "adversary", "adversary", "agent"),
        radius=(0.075, 0.075, 0.075, 0.05),
        acceleration=(3.0, 3.0, 3.0, 4.0),
        top_speed=(1.0, 1.0, 1.0, 1.3),
        landmark_radius=0.2,
        landmark_range=0.9,
        statistics=("contacts",),
    ),
}
PAPER: dict[str, Any] = {
    "velocity_first": True,
    "direction": 1.0,
    "squared": True,
    "summed": True,
    "self_contact": True,
    "share": 1.0,
}
MPE2: dict[str, Any] = {
    "velocity_first": False,
    "direction": -1.0,
    "squared": False,
    "summed": False,
    "self_contact": False,
    "share": 0.5,
}


class Env(vector.VectorEnv):
    """The particle environments; see the module's docstring."""

    can_draw, picture = True, "envs.pictures.mpe"

    def __init__(
        self,
        name: str,
        num_envs: int,
        seed: int,
        copy: bool,
        *,
        scenario: str,
        paper: bool,
        selfplay: bool,
        opponent: str | os.PathLike[str] | None = None,
    ) -> None:
        """paper: the paper's game, else mpe2's. selfplay: the agents of team 1 learn too.

        opponent: the archive of the network that plays team 1 otherwise; None for the one that comes with this package.
        Raises InputError for a file without such a network.
        """
        game = SCENARIOS[scenario]
        n_agents, team = len(game.teams), [i for i, number in enumerate(game.teams) if number == 0]
        all_learn = selfplay or 1 not in game.teams
        learning = range(n_agents) if all_learn else range(team[0], team[-1] + 1)
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=len(learning),
            n_actions=5,
            obs_size=game.obs_size,
            episode_limit=EPISODE_LIMIT,
            low=-np.inf,
            high=np.inf,
            statistics=game.statistics,
            teams=[game.teams[i] for i in learning],
            choices=[game.n_actions[i] for i in learning],
            kinds=game.kinds if all_learn else None,
        )
        unused = np.zeros(num_envs, np.float32)
        self.game = State(
            random=np.zeros(num_envs, np.uint64),
            steps=np.zeros(num_envs, np.int64),
            score=np.zeros(num_envs),
            agent_position=np.zeros((num_envs, n_agents, 2)),
            agent_velocity=np.zeros((num_envs, n_agents, 2)),
            landmark_position=np.zeros((num_envs, game.landmarks, 2)),
            goal=np.zeros(num_envs, np.int64),
            symbol=np.zeros(num_envs, np.int64),
            force=np.zeros((num_envs, n_agents, 2)),
            own_rewards=np.zeros((num_envs, n_agents)),
            opponent_action=np.zeros(num_envs, np.int64),
            views=self.observations if all_learn else np.zeros((num_envs, n_agents, game.obs_size), np.float32),
            contacts=self.statistics.get("contacts", unused),
            occupied_landmarks=self.statistics.get("occupied_landmarks", unused),
            goal_distance=self.statistics.get("goal_distance", unused),
            adversary_distance=self.statistics.get("adversary_distance", unused),
            observations=self.observations,
            agent_rewards=self.agent_rewards,
            rewards=self.rewards,
            truncated=self.truncated,
        )
        self.config = Config(
            scenario=game.number,
            opponent=-1 if all_learn else game.teams.index(1),
            first=learning[0],
            team_first=team[0],
            team_size=len(team),
            radius=np.array(game.radius),
            acceleration=np.array(game.acceleration),
            top_speed=np.array(game.top_speed),
            landmark_radius=game.landmark_radius,
            landmark_range=game.landmark_range,
            **(PAPER if paper else MPE2),
        )
        self.team_of = game.teams
        self._arguments = (tuple(self.game), tuple(self.config))
        self._step_arguments = (*self._arguments, self.action_mask)

        if not all_learn:
            network = read_network(OPPONENTS / f"mpe-{scenario}.npz" if opponent is None else opponent, scenario)
            biases = (network.first_bias, network.core_bias, network.last_bias)
            first, core, last = (np.zeros_like(bias) for bias in biases)
            plays = (self.game.views, self.config.opponent, self.game.opponent_action)
            self._opponent_arguments = (*network, first, core, last, *plays)

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        reset_all(*self._arguments, mask, seed, episodes)
        if self.config.opponent >= 0:
            decide_all(*self._opponent_arguments, mask)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        refused = step_all(*self._step_arguments, actions, playing)
        if self.config.opponent >= 0 and refused < 0:
            decide_all(*self._opponent_arguments, playing)
        return refused
