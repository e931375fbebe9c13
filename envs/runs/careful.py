"""What a trained team is given by somebody's program is looked at before it acts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from envs.vector import InputError

if TYPE_CHECKING:
    from envs.runs.run import Team

SomeTeam = TypeVar("SomeTeam", bound="Team")


def careful(team: SomeTeam, saved: Mapping[str, Any]) -> SomeTeam:
    """The same team, whose `act` now raises InputError, a ValueError, where actions would mean nothing.

    PyTorch itself broadcasts an array that has no axis for environments, and where no value is a number the first
    action is the best one. A training does without this: its environment keeps to a contract.
    saved: the checkpoint that it comes from.
    """
    vars(team)["act"] = CarefulAct(team, *saved["network"][:3])
    return team


class CarefulAct:
    """What a loaded team has in the place of its class's `act`. An object, so that copies of a team have their own.

    It looks at the values each time, and at the form again where that is another one.
    """

    def __init__(self, team: Team, n_agents: int, obs_size: int, n_actions: int) -> None:
        self.team, self.n_agents, self.obs_size, self.n_actions = team, n_agents, obs_size, n_actions
        self.form: Any = None
        self.zeros: Any = None
        self.nothing = bytes(n_actions)  # of a mask, as booleans

    def __call__(self, observations: NDArray[np.float32], info: dict[str, Any]) -> NDArray[np.int64]:
        """Actions, [env, agent]; see `Team.act` of the script. InputError where they would mean nothing.

        To look takes 3 to 5 microseconds in each call; to act itself takes 140, and a step of one game of simple_spread
        420.
        """
        mask: Any = info.get("action_mask") if isinstance(info, dict) else None
        try:
            form = observations.shape, observations.dtype, mask.shape, mask.dtype
        except AttributeError:  # no arrays
            form = None
        if form is None or form != self.form:
            self.check_form(observations, mask)
            self.form, self.zeros = form, np.zeros(observations.size, observations.dtype)
        if np.vdot(observations, self.zeros) != 0:  # 0 times NaN or infinity is NaN
            raise InputError("The team is given observations that are no finite numbers.")
        if self.nothing in mask.tobytes() or mask.dtype != np.bool_:  # maybe a row's end and the start of the next one
            allowed = mask.astype(np.bool_)
            if (allowed != mask).any() or not allowed.any(axis=2).all():
                raise InputError(
                    'info["action_mask"] must have 1 for what is allowed and 0 for what is not, and some 1.'
                )
        return type(self.team).act(self.team, observations, info)

    def check_form(self, observations: Any, mask: Any) -> None:
        """Raises InputError where these are not arrays of the team's sizes, or of other environments than it plays."""
        seen = shape("observations", observations, self.n_agents, self.obs_size)
        allowed = shape('info["action_mask"]', mask, self.n_agents, self.n_actions)
        if seen[0] != allowed[0]:
            raise InputError(f"The team is given observations of {seen[0]} environments and masks of {allowed[0]}.")
        remembered = sum(len(x[0]) for x in getattr(self.team, "hidden", None) or [] if x is not None)
        if remembered not in (0, seen[0] * self.n_agents):
            raise InputError(
                f"The team has begun to play {remembered // self.n_agents} environments, and is given {seen[0]}; "
                "reset() begins anew."
            )


def shape(name: str, array: Any, *sizes: int) -> tuple[int, ...]:
    """The shape of an array of numbers. Raises InputError where it is none, [env, agent, ...], of these sizes."""
    needed = f"The team needs {name} as an array of numbers, [env, {', '.join(map(str, sizes))}]"
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise InputError(f"{needed}, and is given {type(array).__name__}.")
    if array.ndim != 3 or array.shape[1:] != sizes:
        raise InputError(f"{needed}, and is given {[*array.shape]}.")
    return array.shape
