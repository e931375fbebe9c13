"""What networks and optimisers take from a checkpoint: no more than it holds, and only what they can go on from."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from envs.runs.valid import Invalid


class AtMost(TorchFunctionMode):
    """Modules that are made here have weights of so many bytes at most, all together.

    Raises Invalid for more, before the memory is written, and so taken.
    """

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Looks at what PyTorch's modules get their weights from."""
        result = func(*args, **(kwargs or {}))
        if func is torch.empty:
            self.room -= result.nbytes
            if self.room < 0:
                raise Invalid("it names a larger network than it holds")
        return result


def load_part(part: Any, saved: Any) -> None:
    """part.load_state_dict(saved), where a network gets finite weights, and an optimiser what its next step needs.

    PyTorch itself looks only at the shapes of weights. Raises Invalid, or what it raises.
    """
    if isinstance(part, torch.optim.Optimizer):
        saved = fitting_state(part, saved)
    part.load_state_dict(saved)
    if isinstance(part, torch.nn.Module) and not all(x.isfinite().all() for x in part.state_dict().values()):
        raise Invalid("it has weights that are no numbers")


def fitting_state(optimiser: torch.optim.Optimizer, saved: Any) -> dict[str, Any]:
    """What an optimiser takes from a saved one: its state, and the numbers of its settings, such as a learning rate.

    The other settings are the optimiser's own. Raises Invalid where the state is not what it would have after a step.
    """
    unfit = Invalid("what it says of an optimiser is not valid")
    after_a_step = copy.deepcopy(optimiser)
    for group in after_a_step.param_groups:
        for x in group["params"]:
            x.grad = torch.zeros_like(x)
    after_a_step.step()
    ours = after_a_step.state_dict()
    for number, state in saved["state"].items():
        for name, x in ours["state"][number].items():
            if not is_like(state[name], x) or (name in ("step", "exp_avg_sq") and state[name].min() < 0):
                raise unfit
    groups = []
    for own, theirs in zip(ours["param_groups"], saved["param_groups"], strict=True):
        if theirs["params"] != own["params"]:
            raise unfit
        numbers = {name: theirs[name] for name, value in own.items() if name in theirs and is_a_number(value)}
        if not all(is_a_number(value) and 0 <= value < math.inf for value in numbers.values()):
            raise unfit
        groups.append(own | numbers)
    return {"state": saved["state"], "param_groups": groups}


def is_a_number(value: Any) -> bool:
    """Whether something is a number of Python's."""
    return type(value) in (int, float)


def is_like(theirs: Any, ours: Any) -> bool:
    """Whether something is of the same kind; a tensor: of the same shape and type, and finite."""
    if not isinstance(ours, Tensor):
        return type(theirs) is type(ours)
    alike = isinstance(theirs, Tensor) and (theirs.shape, theirs.dtype) == (ours.shape, ours.dtype)
    return alike and bool(theirs.isfinite().all())
