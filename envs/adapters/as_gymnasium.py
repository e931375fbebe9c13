"""Tasks by name in Gymnasium, for loops that use `gymnasium.make_vec` and Gymnasium's wrappers for vectors.

    import gymnasium
    import envs    # registers the ids; the id "envs:marl/..." imports it by itself

    gymnasium.make_vec("marl/lbf-8x8-2p-2f-c", num_envs=8, seed=1)      every task of the paper has an id
    gymnasium.make_vec("marl/task", num_envs=8, task="lbf-5x5-2p-1f")   this is the id of all other tasks

One environment by itself, `gymnasium.make("marl/lbf-8x8-2p-2f-c")`, has the form of lbforaging's and rware's; see
`envs.adapters.as_tuples`.

In a vector the contract of `envs.vector` holds, except that finished sub-environments begin their next episode by
themselves. The option autoreset_mode, one of `gymnasium.vector.AutoresetMode` or its value, says when:

    NEXT_STEP   In the next step. That step belongs to no episode: the actions are ignored, even forbidden ones, the
                reward is 0, the flags are down and the observation is the first one of the new episode. A learner must
                leave out such steps: those before which a flag was up. This is the default, as it is Gymnasium's.
    SAME_STEP   In the same step. What `step` returns with a flag that is up is the reward of the old episode, and the
                first observation and info of the new one. The last ones of the old episode are info["final_obs"] and
                info["final_info"], for those sub-environments that info["_final_obs"] and info["_final_info"] name.
                (Before Gymnasium 1.4 its `RecordEpisodeStatistics` miscounts returns in this mode.)
    DISABLED    Not at all, as with `envs.make`: the loop calls reset(options={"reset_mask": finished}).

The episodes are the same ones in all three modes. With render_mode="rgb_array" `render` returns a frame of each
sub-environment. `unwrapped` is the environment that `envs.make` builds, with n_agents, choices, teams and so on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorWrapper
from numpy.typing import NDArray

import envs
from envs.tasks import task_names
from envs.vector import Info, InputError, VectorEnv, fresh_seed

FRAMES_PER_SECOND = 5  # of videos, as in the films of `envs.render`


def register() -> None:
    """Give each task of the paper an id in Gymnasium, and one more id to all other tasks."""
    ids: dict[str, dict[str, Any]] = {f"marl/{name}": {"task": name} for name in task_names()}
    for id, settings in (ids | {"marl/task": {}}).items():
        if id not in gymnasium.registry:
            gymnasium.register(
                id,
                entry_point="envs.adapters.as_tuples:TupleEnv",
                vector_entry_point="envs.adapters.as_gymnasium:make_vec",
                disable_env_checker=True,  # which knows no rewards of several agents
                kwargs=settings,
            )


def make_vec(
    num_envs: int,
    *,
    task: str,
    seed: int | None = None,
    env_kwargs: str | Mapping[str, Any] = "",
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    render_mode: str | None = None,
) -> Autoreset:
    """What `gymnasium.make_vec` calls.

    task, num_envs, seed, env_kwargs: as in `envs.make`. Without a seed, one is drawn that nobody has chosen. A later
    reset(seed=...) takes the place of the seed.
    autoreset_mode, render_mode: see the module's docstring.
    Raises what `envs.make` raises, and InputError for an unknown mode.
    """
    modes = [mode.value for mode in AutoresetMode]
    if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in modes:
        raise InputError(f"autoreset_mode is {autoreset_mode!r}; the modes are {', '.join(modes)}.")
    seed = fresh_seed() if seed is None else seed
    env = envs.make(task, num_envs, seed, env_kwargs=env_kwargs, pictures=render_mode is not None)
    return Autoreset(env, AutoresetMode(autoreset_mode), render_mode)


def rendering(env: VectorEnv, render_mode: str | None, human: bool = False) -> dict[str, Any]:
    """What an environment's metadata say about its pictures.

    human: whether it can also show them in a window, where there is a display.
    Raises InputError for a mode that does not exist, and where the environment cannot draw.
    """
    modes = ["rgb_array", "human"] if human else ["rgb_array"]
    if render_mode not in (None, *modes):
        raise InputError(f"render_mode is {render_mode!r}; it must be {', '.join(map(repr, modes))} or None.")
    if render_mode and not env.can_draw:
        raise InputError(f"{env.name} has no pictures, so it cannot be rendered.")
    if render_mode == "human" and not has_display():
        modes.remove("human")
    return {"render_modes": modes if env.can_draw else [], "render_fps": FRAMES_PER_SECOND}


def has_display() -> bool:
    """Whether matplotlib can open windows here."""
    import matplotlib
    from matplotlib.backends import BackendFilter, backend_registry

    return matplotlib.get_backend().lower() in backend_registry.list_builtin(BackendFilter.INTERACTIVE)


class Window:
    """Shows frames in a window of matplotlib."""

    def __init__(self, title: str) -> None:
        from matplotlib import pyplot

        self.pyplot = pyplot
        self.figure = pyplot.figure(title)
        self.image: Any = None

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show a frame, uint8 [height, width, 3], for as long as it is seen in a film."""
        if self.image is None:
            axes = self.figure.add_axes((0, 0, 1, 1))
            axes.set_axis_off()
            self.image = axes.imshow(frame)
        self.image.set_data(frame)
        self.pyplot.pause(1 / FRAMES_PER_SECOND)

    def close(self) -> None:
        """Close the window."""
        self.pyplot.close(self.figure)


class Autoreset(VectorWrapper):
    """Resets the sub-environments that have finished; see the module's docstring."""

    env: VectorEnv

    def __init__(self, env: VectorEnv, mode: AutoresetMode, render_mode: str | None = None) -> None:
        """Raises InputError where the environment cannot draw."""
        super().__init__(env)
        self.mode = mode
        self.metadata = env.metadata | rendering(env, render_mode) | {"autoreset_mode": mode}
        env.render_mode = render_mode

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """As in `VectorEnv`, with resets."""
        if self.mode is AutoresetMode.NEXT_STEP:
            return self._step_or_reset(actions)
        if self.mode is AutoresetMode.SAME_STEP:
            return self._step_and_reset(actions)
        return self.env.step(actions)

    def _step_or_reset(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        """NEXT_STEP: those that finished in an earlier step are reset, the others step."""
        finished = self.env.terminated | self.env.truncated
        if not finished.any():
            return self.env.step(actions)
        actions = np.array(actions)
        if actions.shape == self.action_space.shape:  # in place of ignored actions some that are allowed
            actions[finished] = self.env.action_mask[finished].argmax(axis=2)
        _, rewards, terminated, truncated, _ = self.env.step(actions)  # the finished stand still, with reward 0
        observations, info = self.env.reset(options={"reset_mask": finished})
        return observations, rewards, terminated & ~finished, truncated & ~finished, info

    def _step_and_reset(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        """SAME_STEP: all step, and then those that have finished are reset."""
        observations, rewards, terminated, truncated, last_info = self.env.step(actions)
        finished = terminated | truncated
        if not finished.any():
            return observations, rewards, terminated, truncated, last_info
        final: Info = {}
        for i in np.flatnonzero(finished).tolist():
            own_info = {key: values[i] for key, values in last_info.items() if key != "statistics"}
            own_info["statistics"] = {name: values[i] for name, values in last_info["statistics"].items()}
            final = self._add_info(final, {"final_obs": observations[i], "final_info": own_info}, i)
        observations, info = self.env.reset(options={"reset_mask": finished})
        return observations, rewards, terminated, truncated, info | final

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """A frame, uint8 [height, width, 3], of each sub-environment."""
        if self.render_mode is None:
            raise InputError(f'{self.env.name} is rendered only if it was made with render_mode="rgb_array".')
        return tuple(self.env.frame(i) for i in range(self.num_envs))
