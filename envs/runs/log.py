"""What a run shows while it lasts: the progress bar, TensorBoard, progress.json."""

from __future__ import annotations

import contextlib
import json
import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from tqdm import tqdm

from envs import optional
from envs.runs.directory import write_whole
from envs.runs.terminal import Diverged, say
from envs.vector import InputError

PROGRESS_SECONDS = 2.0  # between two writes of progress.json
LINE_SECONDS = 10.0, 300.0  # without a terminal, between two lines: at first, and at most, since it doubles


def in_words(results: Mapping[str, float]) -> str:
    """The results of an evaluation in one line."""
    return ", ".join(f"{name} {value:.3f}" for name, value in results.items())


class Log:
    """The progress bar, TensorBoard's file, progress.json for whoever watches many runs, and Weights & Biases."""

    def __init__(self, path: Path, args: Any, timestep: int, resumed: bool) -> None:
        """path: of the run's directory. What TensorBoard's file says of steps after `timestep` is taken back."""
        from torch.utils.tensorboard import SummaryWriter

        if args.track:
            wandb = optional("wandb")
            if not (path / "wandb-id").exists():
                write_whole(path / "wandb-id", f"{secrets.token_hex(8)}\n")
            identity = (path / "wandb-id").read_text().strip()
            try:
                wandb.init(id=identity, name=str(path), config=vars(args), resume="allow", sync_tensorboard=True)
            except wandb.errors.Error as error:  # nobody is logged in, for one
                raise InputError(f"--track: {error}") from error
        self.path, self.total = path, args.total_timesteps
        self._write_progress({})
        self.sums_rewards = args.env.startswith("pettingzoo:") and not getattr(args, "individual_rewards", False)
        self.begun_at = self.timestep = timestep
        self.started = self.shown = self.said = time.monotonic()
        self.pause = LINE_SECONDS[0]
        self.last_evaluation: float | None = None
        self.returns: deque[float] = deque(maxlen=100)  # of the last training episodes
        self.lengths: deque[float] = deque(maxlen=100)
        threading.excepthook = show_error
        self.writer: SummaryWriter | None = None
        with self._writing():
            self.writer = SummaryWriter(str(path), purge_step=timestep + 1 if resumed else None)
        self.bar = tqdm(total=self.total, initial=timestep, unit=" steps", unit_scale=True, disable=None)
        say(f"This run is kept in {path}")

    def evaluation(self, timestep: int, results: Mapping[str, float]) -> None:
        """Shows an evaluation."""
        self.last_evaluation = results["return_mean"]
        self._write({f"evaluation/{name}": value for name, value in results.items()}, timestep)
        self.said = time.monotonic()
        say(f"step {timestep:,}: {in_words(results)}")
        if timestep == 0 and self.sums_rewards and results["return_mean"] == results["return_std"] == 0:
            say(
                "All returns are 0. Where the agents' rewards cancel out, as in a game of two opponents, "
                "--individual-rewards (of all scripts but COMA, VDN and QMIX) lets each agent learn from its own."
            )

    def batch(
        self, timestep: int, returns: Sequence[float], lengths: Sequence[float], metrics: Mapping[str, Any]
    ) -> None:
        """Shows a batch of training episodes that ends at this timestep.

        returns, lengths: of its episodes.
        metrics: tensors of one number, by group and name. TensorBoard gets a thousand points a run. Raises Diverged for
        a loss that is not finite.
        """
        figures = {name: value.item() for name, value in metrics.items()}
        for name, value in figures.items():
            if name.startswith("loss/") and not math.isfinite(value):
                raise Diverged(f"{name} is {value} at step {timestep:,}; the last checkpoint is kept.")
        self.returns.extend(returns)
        self.lengths.extend(lengths)
        now = time.monotonic()
        speed = (timestep - self.begun_at) / max(now - self.started, 1e-9)
        recent = fmean(self.returns)
        if now - self.shown >= PROGRESS_SECONDS:
            self.shown = now
            progress = {
                "timestep": timestep,
                "total_timesteps": self.total,
                "steps_per_second": speed,
                "training_return": recent,
                "evaluation_return": self.last_evaluation,
            }
            self._write_progress(progress)
        said = "" if self.last_evaluation is None else f", evaluation {self.last_evaluation:.3f}"
        self.bar.set_postfix_str(f"return {recent:.3f}{said}", refresh=False)
        if self.bar.disable and now - self.said >= self.pause:
            self.said, self.pause = now, min(2 * self.pause, LINE_SECONDS[1])
            left = tqdm.format_interval(max(self.total - timestep, 0) / speed)
            say(f"step {timestep:,} of {self.total:,}: return {recent:.3f}, {speed:,.0f} steps/s, {left} left")
        self.bar.update(timestep - self.timestep)
        due = timestep * 1000 // self.total > self.timestep * 1000 // self.total
        self.timestep = timestep
        if due:
            figures["training/return_mean"] = recent
            figures["training/episode_length"] = fmean(self.lengths)
            figures["training/steps_per_second"] = speed
            self._write(figures, timestep)

    def _write_progress(self, progress: Mapping[str, Any]) -> None:
        """Writes progress.json, or not: it is only there to be looked at, and the next one comes soon."""
        path = self.path / "progress.json"
        new = path.with_name(f"{path.name}.new")
        with contextlib.suppress(OSError):
            new.write_text(json.dumps(progress) + "\n")
            new.replace(path)

    def _write(self, figures: Mapping[str, float], timestep: int) -> None:
        """Hands figures to TensorBoard, whose thread may have met an error since the last ones."""
        if self.writer:
            with self._writing():
                for name, value in figures.items():
                    self.writer.add_scalar(name, value, timestep)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Where TensorBoard's file cannot be written, says so once; the run goes on without it."""
        try:
            yield
        except OSError as error:
            self.writer = None
            say(f"{self.path}: TensorBoard's file cannot be written ({error.strerror}); the run goes on without it.")

    def close(self) -> None:
        """Ends the progress bar and TensorBoard's file."""
        self.bar.close()
        if self.writer:
            with self._writing():
                self.writer.close()


def show_error(failure: threading.ExceptHookArgs) -> None:
    """Shows what went wrong in a thread, but not in TensorBoard's: it keeps an error, such as a full disk, for the next
    call of its writer, and so the main thread says it in a sentence."""
    if not type(failure.thread).__module__.startswith("tensorboard."):
        threading.__excepthook__(failure)
