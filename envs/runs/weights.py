"""How many weights networks may have that are made for a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
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
