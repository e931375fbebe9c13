"""Errors in code that is not ours, in one sentence: what fails, where, and with which words."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path

import gymnasium
import numpy as np

# Code that only passes a call on: an error is not its fault. Also ours, but for what a user would see as a game
GYMNASIUM = Path(gymnasium.__file__).parent
PASS_ON = [
    Path(__file__).parent,
    Path(np.__file__).parent,
    *(GYMNASIUM / name for name in ("core.py", "wrappers", "spaces", "utils", "envs/registration.py")),
]
LIBRARIES = ("pettingzoo/utils/", "supersuit/", "importlib/")
STANDARD = Path(sysconfig.get_path("stdlib"))


def in_words(error: BaseException) -> str:
    """An error's kind and text, in one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place(error: BaseException) -> str | None:
    """File and line of a game in which an error came up; None where it came up between us and the game.

    Where an error was raised because of another one, that one counts.
    """
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    for cause in (error.__cause__, error.__context__):
        if cause is not None and (found := place(cause)):
            return found
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if is_a_games(frame.filename)]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else None


def is_ours(error: BaseException) -> bool:
    """Whether it was raised here, as by a signal that ends the program, and not by the code that was called."""
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and Path(frames[-1].filename).is_relative_to(PASS_ON[0])


def is_a_games(file: str) -> bool:
    """Whether code in this file can be a game's."""
    path = Path(file)
    if not path.is_absolute() or any(library in path.as_posix() for library in LIBRARIES):
        return False  # such as <frozen importlib._bootstrap>
    if path.is_relative_to(STANDARD):
        return bool({"site-packages", "dist-packages"} & set(path.parts))
    return not any(path == folder or path.is_relative_to(folder) for folder in PASS_ON)
