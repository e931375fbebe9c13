"""What a checkpoint must say. Whoever made it may have put anything into it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from envs.runs.flags import check_flags
from envs.runs.valid import Invalid, check_plain
from envs.vector import InputError

MOST = 2**62  # of a count
CLOSEST = 10  # evaluation points in a batch, where a longer run does not keep its own distance


def is_count(value: Any, least: int = 0) -> bool:
    """Whether something is a whole number, from `least` on, as the counters of a run are."""
    return type(value) is int and least <= value <= MOST


def is_number(value: Any) -> bool:
    """Whether something is a number, which may be infinite or none."""
    return type(value) in (int, float)


def is_dictionary(value: Any, *kinds: type) -> bool:
    """Whether something is a dictionary with texts as keys, and, if kinds are named, values of these."""
    return isinstance(value, dict) and all(
        isinstance(key, str) and (not kinds or isinstance(each, kinds)) for key, each in value.items()
    )


def check_config(config: Any) -> None:
    """Raises Invalid where something is not what config.json says of a run: its algorithm, and flags that exist."""
    if not is_dictionary(config) or not all(is_dictionary(config.get(part)) for part in ("flags", "changed")):
        raise Invalid("it has no flags")
    flags = config["flags"]
    for name, text in (("algorithm", config.get("algorithm")), ("env", flags.get("env"))):
        if not isinstance(text, str) or not text.isprintable():
            raise Invalid(f"what it says of {name} is not valid")
    if not isinstance(flags.get("parameter_sharing"), bool) or not isinstance(flags.get("env_kwargs", ""), str):
        raise Invalid("what it says of parameter_sharing or env_kwargs is not valid")
    if not is_count(flags.get("total_timesteps"), 1) or not is_count(flags.get("seed")):
        raise Invalid("what it says of total_timesteps or seed is not valid")
    try:
        check_flags(SimpleNamespace(**flags))
    except (InputError, TypeError) as error:
        raise Invalid(f"what it says of its flags is not valid: {error}") from error


def check_checkpoint(saved: Any, size: int) -> None:
    """Raises Invalid where something is not a run's checkpoint, or a team's, that a file of so many bytes holds."""
    check_plain(saved, size, tensors=True)
    if not is_dictionary(saved):
        raise Invalid("it is no dictionary")
    check_plain([saved.get("config"), saved.get("rows")], size)  # these are written again, as text
    check_config(saved.get("config"))
    rows, seconds, network, parts = (saved.get(name) for name in ("rows", "seconds", "network", "parts"))
    if not isinstance(rows, list) or not all(is_dictionary(row, int, float) for row in rows):
        raise Invalid("what it says of evaluations is not valid")
    if not all(is_count(row.get("point")) and is_count(row.get("timestep")) for row in rows):
        raise Invalid("what it says of evaluations is not valid")
    times = {"wall_seconds", "cpu_seconds"}
    if (
        not is_dictionary(seconds, int, float)
        or seconds.keys() != times
        or not all(0 <= value < math.inf for value in seconds.values())
    ):
        raise Invalid("what it says of seconds is not valid")
    if not isinstance(network, list | tuple) or len(network) != 4 or not all(map(is_count, network[:3])):
        raise Invalid("what it says of its network is not valid")
    if not is_dictionary(parts, dict) or not is_dictionary(parts.get("agents")):
        raise Invalid("it has no agents")
    if not all(is_finite(weights) for weights in parts["agents"].values()):
        raise Invalid("its agents have weights that are no numbers")


def is_finite(weights: Any) -> bool:
    """Whether weights of a network are a tensor of finite numbers."""
    import torch

    return isinstance(weights, torch.Tensor) and not weights.is_complex() and bool(weights.float().isfinite().all())


def check_counters(saved: Mapping[str, Any]) -> None:
    """Raises Invalid where a checkpoint does not say where its run goes on, as a team's does not."""
    import torch

    counters = (saved.get(name) for name in ("episode", "timestep", "updates"))
    rng = saved.get("rng")
    if not all(map(is_count, counters)) or not isinstance(rng, torch.Tensor) or rng.dtype != torch.uint8:
        raise Invalid("it does not say where its run goes on")
    flags: dict[str, Any] = saved["config"]["flags"]
    budget: Any = saved.get("budget")
    points: Any
    points, total = flags.get("eval_points"), flags["total_timesteps"]
    wrong = Invalid("what it says of its evaluations is not valid")
    if not is_count(points, 1) or not is_count(budget, 1) or total * (points - 1) % budget:
        raise wrong
    before = 0
    for point, row in enumerate(saved["rows"]):
        due = point * budget <= min(row["timestep"], total) * (points - 1)  # see Run.point_is_due
        if row["point"] != point or not due or not before <= row["timestep"] <= saved["timestep"]:
            raise wrong
        before = row["timestep"]


def check_distance(points: int, first_total: int, total: int, timestep: int, rows: int, batch: int) -> None:
    """Raises Invalid where a run that became longer would be evaluated all the time.

    points: in the first total, evenly; rows: evaluations so far; batch: the most steps of a batch.
    """
    if total == first_total:
        return
    due = min(timestep, total) * (points - 1) // first_total + 1 - rows
    passed = batch * (points - 1) // first_total
    if (most := max(due, passed)) > max(points, CLOSEST):
        raise Invalid(f"a batch would pass {most:,} of its evaluation points")
