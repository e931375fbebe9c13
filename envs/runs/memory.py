"""What a team remembers of its episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def forgotten(hidden: list[Any] | None, mask: NDArray[np.bool_]) -> list[Any] | None:
    """The states of a team's GRUs, with zeros, as at the start of an episode, in the environments of a mask, [env].

    hidden: the state of each network, [1, env * agent, hidden_dim], or None for one without; None before the first
    step.
    """
    if hidden is None or hidden[0] is None:
        return hidden
    kept = (~mask).tolist()
    states = [state.unflatten(1, (len(kept), -1)) for state in hidden]  # [1, env, agent, hidden_dim]
    return [(state * state.new_tensor(kept)[:, None, None]).flatten(1, 2) for state in states]
