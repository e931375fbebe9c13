"""What a game lets an agent see, as one vector, in the order of `gymnasium.spaces.flatten`.

Values count, and not their types: lists, and arrays of other types, are fine where each value is one of the space. A
number of a Discrete, MultiDiscrete or MultiBinary space becomes a one among zeros. A value outside its space would
become another one, and is refused. The bounds of a Box do not matter, and nothing is cut to its type.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


def flattened(space: Any, value: Any) -> NDArray[np.float32]:
    """[value]. Raises ValueError, TypeError or KeyError where it does not fit the space."""
    if isinstance(space, spaces.Box):
        given = np.asarray(value)
        if given.dtype.kind not in "biufO":  # NumPy makes numbers of texts, dates and complex numbers
            raise ValueError(f"it is of the type {given.dtype}")
        values = given.astype(np.float32, copy=False).ravel()
        if len(values) != space.low.size:
            raise ValueError(f"it has {len(values)} values")
        return values
    if isinstance(space, spaces.Dict):
        return joined([flattened(part, value[name]) for name, part in space.spaces.items()])
    if isinstance(space, spaces.Tuple):
        if len(value) != len(space.spaces):
            raise ValueError(f"it has {len(value)} parts")
        return joined([flattened(part, each) for part, each in zip(space.spaces, value)])
    if isinstance(space, spaces.Discrete):
        return ones(value, np.array([space.n]), np.array([space.start]))
    if isinstance(space, spaces.MultiDiscrete):
        return ones(value, space.nvec, np.broadcast_to(space.start, space.nvec.shape))
    if isinstance(space, spaces.MultiBinary):
        values = np.asarray(value, np.float32).ravel()
        if len(values) != spaces.flatdim(space) or not ((values == 0) | (values == 1)).all():
            raise ValueError(f"{value} is not one of its values")
        return values
    if value not in space:
        raise ValueError(f"{value} is not one of its values")
    return np.asarray(spaces.flatten(space, value), np.float32)


def joined(parts: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """One vector of all parts."""
    return np.concatenate(parts) if parts else np.zeros(0, np.float32)


def ones(value: Any, sizes: NDArray[Any], starts: NDArray[Any]) -> NDArray[np.float32]:
    """For each number, counted from its start, a one among as many zeros as it has values. ValueError for another."""
    numbers, flat = np.asarray(value).ravel(), sizes.ravel()
    if numbers.shape != flat.shape:
        raise ValueError(f"it has {len(numbers)} values")
    counted = numbers - starts.ravel()
    if not ((counted >= 0) & (counted < flat) & (counted == np.floor(counted))).all():
        raise ValueError(f"{value} is not one of its values")
    values = np.zeros(int(flat.sum()), np.float32)
    values[np.cumsum(flat) - flat + counted.astype(np.int64)] = 1
    return values
