"""What one sees of a campaign while it lasts: a table in a terminal, plain lines elsewhere."""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from campaign.plan import PlannedRun

LINES_EVERY = 300  # seconds, where there is no terminal
HEADER = f"{'task':<24} {'algorithm':<20} {'seed':>4} {'done':>5} {'steps/s':>9} {'return':>9} {'time left':>10}"


@dataclass(frozen=True)
class Progress:
    """How far a run is; None: not known yet. share: of its budget. last_return: of evaluation, else of training."""

    share: float = 0.0
    steps_per_second: float | None = None
    last_return: float | None = None
    seconds_left: float | None = None


def read_progress(directory: Path) -> Progress:
    """How far the run in this directory is, by its progress.json."""
    try:
        said = json.loads((directory / "progress.json").read_text())
        timestep, budget, rate = said["timestep"], said["total_timesteps"], said["steps_per_second"]
        last = said["training_return"] if said["evaluation_return"] is None else said["evaluation_return"]
    except (OSError, ValueError, KeyError):
        return Progress()
    left = max(budget - timestep, 0) / rate if rate else None
    return Progress(min(timestep / budget, 1.0), rate or None, last, left)


def table_row(run: PlannedRun, progress: Progress) -> str:
    """A run's line in the table."""
    rate = "" if progress.steps_per_second is None else f"{progress.steps_per_second:,.0f}"
    last = "" if progress.last_return is None else f"{progress.last_return:,.2f}"
    left = "" if progress.seconds_left is None else duration(progress.seconds_left)
    name = f"{run.algorithm} {'shared' if run.sharing else 'independent'}"
    return f"{run.task:<24} {name:<20} {run.seed:>4} {progress.share:>5.0%} {rate:>9} {last:>9} {left:>10}"


def duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


class LineView:
    """Plain lines: what happens when it happens, and now and then how far the runs are."""

    def __init__(self) -> None:
        self.last = time.monotonic()

    def say(self, message: str) -> None:
        """Something happened."""
        print(message, file=sys.stderr, flush=True)

    def show(self, runs: list[PlannedRun], summary: str) -> None:
        """The runs that are being made, and how far the campaign is."""
        if time.monotonic() - self.last >= LINES_EVERY:
            self.last = time.monotonic()
            lines = [time.strftime("%H:%M:%S ") + summary, HEADER]
            lines += [table_row(run, read_progress(run.directory)) for run in runs]
            print("\n".join(lines), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Nothing is left to do."""


class TableView:
    """A table that is redrawn in its place, below what happened; tqdm moves the cursor and keeps to the window."""

    def __init__(self) -> None:
        self.lines: list[tqdm] = []
        self.last = 0.0

    def say(self, message: str) -> None:
        """Something happened."""
        tqdm.write(message, file=sys.stderr)

    def show(self, runs: list[PlannedRun], summary: str) -> None:
        """The runs that are being made, and how far the campaign is, once a second."""
        if time.monotonic() - self.last < 1:
            return
        self.last = time.monotonic()
        texts = [summary, HEADER, *(table_row(run, read_progress(run.directory)) for run in runs)]
        while len(self.lines) < len(texts):
            position = len(self.lines)
            self.lines.append(
                tqdm(bar_format="{desc}", position=position, leave=False, dynamic_ncols=True, file=sys.stderr)
            )
        texts += [""] * (len(self.lines) - len(texts))
        for line, text in zip(self.lines, texts):
            line.set_description_str(text)

    def close(self) -> None:
        """Takes the table away; what happened stays."""
        for line in reversed(self.lines):
            line.close()


def make_view() -> LineView | TableView:
    """The view for the place where messages go."""
    return TableView() if sys.stderr.isatty() else LineView()
