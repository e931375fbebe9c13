"""Whether a file is like those that a run of ours writes. Whoever made it may have put anything into it.

What is found here to be valid is plain, and no larger than its file says: it can be read, compared and written again.
"""

from __future__ import annotations

import json
import math
import stat
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch

DEEPEST = 20  # levels of lists and dictionaries in each other
LARGEST_JSON = 2**24  # bytes
LARGEST_TABLE = 2**26


class Invalid(ValueError):
    """A file is no file of ours; the message ends a sentence that begins with its name."""


def file_size(path: Path, most: float = math.inf) -> int:
    """The size of a file. Raises Invalid for a pipe or a device, which may never end, and for one that is too large."""
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise Invalid("it is no file")
    if found.st_size > most:
        raise Invalid(f"it has {found.st_size:,} bytes, more than any of ours")
    return found.st_size


def read_json(path: Path) -> Any:
    """What a JSON file says. Raises Invalid, and OSError where it cannot be read."""
    size = file_size(path, LARGEST_JSON)
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise Invalid("it is nested too deeply") from None
    except ValueError as error:
        raise Invalid(str(error)) from error
    check_plain(said, size)
    return said


def check_plain(said: Any, size: int, tensors: bool = False) -> None:
    """Raises Invalid where something is no plain type, or says more than a file of so many bytes can say.

    A pickle may name a list twice, and a list of such lists twice, and so on: it is short, and never written to its
    end. tensors: whether they may be there, dense and on the CPU. Each has its own numbers: all together no more than
    ten times those that the file has, since some may share them.
    """
    things, numbers = 0, 0.0
    waiting = [(said, 0)]
    while waiting:
        each, depth = waiting.pop()
        things += 1
        if depth > DEEPEST or things > size:
            raise Invalid("it is nested too deeply")
        if isinstance(each, dict):
            waiting += [(part, depth + 1) for pair in each.items() for part in pair]
        elif isinstance(each, list | tuple):
            waiting += [(part, depth + 1) for part in each]
        elif isinstance(each, str):
            if not is_text(each):
                raise Invalid("it has text that cannot be written")
        elif tensors and hasattr(each, "untyped_storage"):
            own = each.numel() * each.element_size() if is_plain(each) else math.inf
            numbers += own
            if own > size or numbers > 10 * size:
                raise Invalid("it has weights that it does not hold")
        elif each is not None and type(each) not in (bool, int, float):
            raise Invalid(f"it has something of the kind {type(each).__name__}")


def is_text(text: str) -> bool:
    """Whether a text can be written as UTF-8."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def is_plain(tensor: torch.Tensor) -> bool:
    """Whether a tensor is an array of numbers in the memory that it says it has."""
    import torch

    if type(tensor) not in (torch.Tensor, torch.nn.Parameter) or tensor.layout != torch.strided:
        return False
    if tensor.device.type != "cpu" or tensor.is_nested or tensor.is_quantized:
        return False
    return tensor.numel() * tensor.element_size() <= tensor.untyped_storage().nbytes()


def is_whole(checkpoint: Path) -> bool:
    """Whether every byte of a checkpoint is as it was written. PyTorch writes zip files, and does not look at their
    check sums itself. It packs nothing, so that a file holds no more than its own size."""
    try:
        size = file_size(checkpoint)
        with zipfile.ZipFile(checkpoint) as file:
            return sum(part.file_size for part in file.infolist()) <= size and file.testzip() is None
    except Exception:  # zipfile raises almost anything on a damaged file
        return False
