"""The actions of other packages as the choices 0, 1, 2, ... of these algorithms.

    Discrete                     as they are
    MultiDiscrete, MultiBinary   all combinations of their parts, in the order of counting: the last part changes first
    Box                          all combinations of `action_bins` equally distant values in each dimension, from the
                                 lower bound to the upper one

There are at most MOST combinations, and a Discrete has at most MOST_DISCRETE values. A mask has an entry for each
choice; for MultiDiscrete and MultiBinary it may also have one for each value of each part, as a tuple of masks or as
one row of all of them. Then a combination is allowed if each of its parts is.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.vector import InputError

MOST = 1024
MOST_DISCRETE = 2**20  # a network has a row of weights for each; and masks of more fill the memory


class Actions:
    """The choices of one agent: `n` of them, and what each is for the game."""

    def __init__(self, name: str, space: Any, bins: int) -> None:
        """name: of the task. bins: of each dimension of a Box; 0: none. InputError for what has no such choices."""
        self.name, self.first = name, 0
        self.values: list[NDArray[Any]] = []  # of each part
        self.table: NDArray[Any] | None = None  # the combinations
        if isinstance(space, spaces.Discrete):
            self.n, self.first = int(space.n), int(space.start)
            self.check_number(space, "", MOST_DISCRETE)
            return
        if isinstance(space, spaces.MultiDiscrete):
            starts = np.asarray(space.start).ravel()
            self.values = [start + np.arange(size) for start, size in zip(starts, space.nvec.ravel())]
        elif isinstance(space, spaces.MultiBinary):
            self.values = [np.arange(2)] * math.prod(space.shape)
        elif isinstance(space, spaces.Box) and bins == 1:
            raise InputError(f"{name}: `action_bins` is 1; with one value there is nothing to choose.")
        elif isinstance(space, spaces.Box) and bins:
            low, high = space.low.ravel(), space.high.ravel()
            if not (np.isfinite(low).all() and np.isfinite(high).all()):
                raise InputError(f"{name}: `action_bins` needs actions with finite bounds; these are {space}.")
            self.values = [np.linspace(least, most, bins) for least, most in zip(low, high)]
        elif isinstance(space, spaces.Box):
            raise InputError(
                f"{name} has continuous actions, {space}; these algorithms need discrete ones, which `action_bins` "
                "makes of them: so many values in each dimension."
            )
        else:
            raise InputError(f"{name} has actions of the kind {space}; these algorithms need discrete ones.")
        self.n = math.prod(len(values) for values in self.values)
        self.check_number(space, " combinations", MOST)
        self.places = np.array([*itertools.product(*(range(len(values)) for values in self.values))], np.int64)
        parts = [values[places] for values, places in zip(self.values, self.places.T)]
        self.table = np.stack(parts, axis=1).astype(space.dtype).reshape(self.n, *space.shape)

    def check_number(self, space: Any, what: str, most: int) -> None:
        """Raises InputError where these are more choices than `most`."""
        if self.n > most:
            number = f"{self.n:,}" if self.n < 10**15 else f"about 10^{math.log10(self.n):.0f}"
            fewer = "; fewer `action_bins` make fewer" if isinstance(space, spaces.Box) else ""
            raise InputError(
                f"{self.name}: the actions {space} are {number}{what}, and these algorithms choose among at most "
                f"{most:,}{fewer}."
            )

    def __getitem__(self, choice: int) -> Any:
        """The game's action, of the type that its space samples."""
        return np.int64(self.first + choice) if self.table is None else self.table[choice].copy()

    def mask(self, agent: int, mask: Any) -> NDArray[np.bool_]:
        """Which choices are allowed. agent: its number, for what is said of it. InputError for what is no mask."""
        parts = None if self.table is None else self.parts(agent, mask)
        if parts is None:
            return self.allowed(agent, mask, self.n)
        by_part = [self.allowed(agent, part, len(values)) for values, part in zip(self.values, parts)]
        return np.logical_and.reduce([part[places] for part, places in zip(by_part, self.places.T)])

    def parts(self, agent: int, mask: Any) -> list[Any] | None:
        """A mask for each part, or None where the mask is one of all choices."""
        sizes = [len(values) for values in self.values]
        if len(mask) == len(sizes) and all(np.shape(part) == (size,) for part, size in zip(mask, sizes)):
            return list(mask)
        if np.shape(mask) != (sum(sizes),):
            return None
        if sum(sizes) == self.n and len(sizes) > 1:
            raise InputError(
                f"{self.name}: the action mask of agent {agent} has {self.n} values, and can be of {self.n} "
                "combinations or of as many values of their parts; a tuple with a mask for each part says which."
            )
        return np.split(np.asarray(mask), np.cumsum(sizes)[:-1])

    def allowed(self, agent: int, mask: Any, n: int) -> NDArray[np.bool_]:
        """A mask of n values. InputError where it has others than 0 and 1, such as numbers to be added to scores."""
        values = np.asarray(mask)
        if values.shape != (n,):
            raise InputError(f"{self.name}: agent {agent} has {n} actions and the action mask {mask}.")
        if values.dtype == np.bool_:
            return values
        allowed = values.astype(np.bool_)
        if (allowed != values).any():
            raise InputError(
                f"{self.name}: the action mask of agent {agent} must have 1 for what is allowed and 0 for what is not; "
                f"it is {mask}."
            )
        return allowed
