"""What a whole program shares, and code of others may set for itself: the working directory, settings of libraries."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np


class Settings(NamedTuple):
    """Settings of the program. None: not looked at."""

    dtype: Any = None  # PyTorch's, of new tensors
    gradients: bool | None = None  # whether PyTorch makes them
    device: str | None = None  # PyTorch's, of new tensors
    threads: int | None = None  # PyTorch's
    folder: str | None = None  # the working directory
    errors: dict[str, Any] | None = None  # what NumPy does where numbers overflow, for example

    @classmethod
    def now(cls) -> Settings:
        """Those that hold. None of PyTorch's where it is not used. A working directory that was deleted is none."""
        found = cls(*torch_modes())
        if found.dtype is not None:
            torch: Any = sys.modules["torch"]
            found = found._replace(device=str(torch.get_default_device()), threads=torch.get_num_threads())
        folder = None
        with contextlib.suppress(FileNotFoundError):
            folder = os.getcwd()
        return found._replace(folder=folder, errors=dict(np.geterr()))

    def hold(self, now: Settings) -> None:
        """Sets what is not so. now: those that hold."""
        if self == now:
            return
        torch: Any = sys.modules.get("torch")
        if self.dtype not in (None, now.dtype):
            torch.set_default_dtype(self.dtype)
        if self.gradients not in (None, now.gradients):
            torch.set_grad_enabled(self.gradients)
        if self.device not in (None, now.device):
            torch.set_default_device(None if self.device == "cpu" else self.device)
        if self.threads not in (None, now.threads):
            torch.set_num_threads(self.threads)
        if self.folder not in (None, now.folder):
            os.chdir(self.folder or "")
        if self.errors not in (None, now.errors):
            np.seterr(**(self.errors or {}))

    def changed(self, now: Settings) -> list[str]:
        """The names of the settings that are not these."""
        pairs = zip(self._fields, self, now)
        return [name for name, here, there in pairs if here != there and None not in (here, there)]


def torch_modes() -> tuple[Any, bool | None]:
    """PyTorch's type of new tensors, and whether it makes gradients, which take no time; None where it is not used."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not hasattr(torch, "get_default_device"):  # it is imported, to its end
        return None, None
    return torch.get_default_dtype(), torch.is_grad_enabled()


@contextlib.contextmanager
def no_arguments() -> Iterator[None]:
    """Code that reads the command line when it is imported finds nothing there: the arguments are not for it."""
    before = sys.argv
    sys.argv = before[:1]
    try:
        yield
    finally:
        sys.argv = before
