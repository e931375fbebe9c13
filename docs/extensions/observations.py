"""Which value of an observation is what. tests/test_docs.py holds these lists against the games themselves."""

import re
from typing import Any, NamedTuple

import envs


class Value(NamedTuple):
    """One value: of which thing it is, what it says, and the thing's kind (self, friend, thing, foe or nothing)."""

    thing: str
    name: str
    kind: str


def things(thing: str, names: str, kind: str) -> list[Value]:
    """The values of one thing; names: separated by commas."""
    return [Value(thing, name.strip(), kind) for name in names.split(",")]


def kinds(task: str) -> dict[str, list[Value]]:
    """The values that each kind of agent observes, in order; one kind without a name where all agents are alike."""
    family = next(name for name in FAMILIES if task.startswith(name))
    env = envs.make(task)
    found = FAMILIES[family](task, env)
    for values in found.values():  # shorter ones are filled up with zeros
        values += [Value("zeros", "0", "nothing")] * (env.obs_size - len(values))
    return found


def matrix(task: str, env: envs.VectorEnv) -> dict[str, list[Value]]:
    """There is nothing to see."""
    return {"": []}


def lbf(task: str, env: envs.VectorEnv) -> dict[str, list[Value]]:
    """Foods, the agent, the other agents."""
    n_foods = env.obs_size // 3 - env.n_agents
    values = [value for k in range(n_foods) for value in things(f"food {k + 1}", "row, column, level", "thing")]
    values += things("the agent itself", "row, column, level", "self")
    for k in range(env.n_agents - 1):
        values += things(f"other agent {k + 1}", "row, column, level", "friend")
    return {"": values}


DIRECTIONS = "up, down, left, right"


def rware(task: str, env: envs.VectorEnv) -> dict[str, list[Value]]:
    """The agent, then the cells around it row by row."""
    values = things("the agent itself", f"column, row, carries a shelf, {DIRECTIONS}, on a highway", "self")
    sight = (round(((env.obs_size - 8) / 7) ** 0.5) - 1) // 2
    for down in range(-sight, sight + 1):
        for across in range(-sight, sight + 1):
            place = " ".join(
                f"{abs(steps)} {words[steps > 0]}"
                for steps, words in ((down, ("up", "down")), (across, ("left", "right")))
                if steps
            )
            kind = "thing" if down or across else "friend"
            values += things(
                f"cell {place}" if place else "its own cell", f"agent, {DIRECTIONS}, shelf, requested", kind
            )
    return {"": values}


def mpe(task: str, env: envs.VectorEnv) -> dict[str, list[Value]]:
    """See the docstring of the family; what stands to the right of a name is seen from the agent."""
    own = things("velocity", "x, y", "self")
    place = things("position", "x, y", "self")

    def landmarks(number: int) -> list[Value]:
        return [value for k in range(number) for value in things(f"landmark {k}", "x, y", "thing")]

    def others(numbers: list[int], kind: str = "friend") -> list[Value]:
        return [value for k in numbers for value in things(f"agent {k}", "x, y", kind)]

    scenario = re.sub("^mpe2?-|-selfplay$", "", task)
    if scenario == "speaker-listener":
        colours = [Value(f"landmark {k}", "0.65 if goal", "thing") for k in range(3)]
        symbols = [Value("the symbol said", f"{k}", "friend") for k in range(3)]
        return {"agent 0, the speaker": colours, "agent 1, the listener": own + landmarks(3) + symbols}
    if scenario == "spread":
        return {"agent 0": own + place + landmarks(3) + others([1, 2])}
    if scenario == "adversary":
        goal = things("goal", "x, y", "thing")
        return {"the first good agent": goal + landmarks(2) + others([0], "foe") + others([2])}
    prey = things("the prey (agent 3)", "x, y", "foe")
    speed = things("the prey's velocity", "x, y", "foe")
    return {"the first predator": own + place + landmarks(2) + others([1, 2]) + prey + speed}


def smaclite(task: str, env: Any) -> dict[str, list[Value]]:
    """Walks, enemies, the other allies, the unit itself; types where the map has several."""
    names, field, config = env.unit_names, env.field, env.config
    n_types = max(len(field.ally_types), len(field.enemy_types))

    def unit(shields: bool, types: tuple[str, ...]) -> str:
        bits = [types[k] if k < len(types) else "-" for k in range(n_types)]
        return ", ".join(["hp", *["shield"] * shields, *bits])

    enemies, allies = unit(config.enemy_shields, field.enemy_types), unit(config.ally_shields, field.ally_types)
    values = things("may walk", "north, south, east, west", "self")
    n_allies = env.n_agents
    for k, name in enumerate(names[n_allies:]):
        values += things(f"enemy {k}, {name}", f"may be attacked, distance, x, y, {enemies}", "foe")
    for k, name in enumerate(names[1:n_allies], 1):
        values += things(f"ally {k}, {name}", f"seen, distance, x, y, {allies}", "friend")
    return {f"agent 0, {names[0]}": values + things("the unit itself", allies, "self")}


FAMILIES = {"matrix": matrix, "lbf": lbf, "rware": rware, "mpe": mpe, "smaclite": smaclite}
