"""For all tests."""

from envs import runs  # isort: skip  # noqa: F401 (before PyTorch, as in the scripts: matrix products are as there)
import gc
import os
import signal
from pathlib import Path

import pytest
from filelock import FileLock

# Programs that tests start import this checkout, whatever is installed
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(Path(__file__).resolve().parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
)

if hasattr(signal, "SIGHUP"):  # `nohup` has it ignored, and programs keep it so; tests ask what it does otherwise
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(config, items):
    """Leaves out the tests with the marker nightly, unless -m names it."""
    if "nightly" not in config.option.markexpr:
        items[:] = [item for item in items if item.get_closest_marker("nightly") is None]


def pytest_collection_finish():
    """What was imported stays: collections need not look at it, and processes that tests fork need not copy it."""
    gc.freeze()


@pytest.fixture(scope="session")
def made_once(tmp_path_factory, worker_id):
    """made_once(name, make) gives a folder that `make`, called with its path, has filled: once for all processes of
    pytest-xdist."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent

    def give(name, make):
        folder, done = shared / name, Path(f"{shared / name}.done")
        with FileLock(f"{folder}.lock"):
            if not done.exists():
                make(folder)
                done.touch()
        return folder

    return give
