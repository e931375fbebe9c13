"""Malformed runs and teams, made from good ones by a seed, and what the programs do with them.

    python tests/fuzz.py <folder with good runs> <folder for the cases> <first seed> <last seed>

Each case is a folder: `gift`, which somebody else has made, `work`, where the program is started, and `victim`. One
program uses the gift: a script watches it, starts from it or goes on with it, or it is collected. It has to end within
20 seconds of CPU time, two minutes on the clock and 1 GB, with 0 or 2, without a traceback, and without a change
anywhere but in `gift` and `work`. A process for each is forked from one that has imported PyTorch. Prints a line for
each case that is not so.
"""

import copy
import functools
import gc
import importlib
import io
import json
import math
import os
import random
import resource
import shutil
import signal
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "algos")]

import torch  # noqa: E402
import torch._dynamo  # noqa: E402 (the first optimiser of a process imports it, for 1.7 seconds)

import envs.runs  # noqa: E402

SECONDS, MEMORY = 20, 2**30
CLOCK = 120
USES = ("watch", "start", "resume", "collect")

Path_ = tuple[Any, ...]


def nested(depth: int) -> Any:
    """A list in a list, and so on."""
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


def doubled(times: int) -> Any:
    """A list that is short in a pickle, and has 2 ** times parts when it is written."""
    value: Any = ["x"]
    for _ in range(times):
        value = [value, value]
    return value


def wide(*shape: int) -> Any:
    """A tensor of this shape that has one number."""
    return torch.zeros(1).expand(*shape)


TASKS = ["own:evil", "pettingzoo:evil", "gymnasium:evil:evil-v0", "gymnasium:x", "mpe-tag", "rware-large-20p-5s"]
TASKS += ["lbf-16000000x16000000-2p-1f"]
TEXTS = ["", "x", "..", "../victim", "/dev/zero", "\ud800", "opponent='/dev/zero'", "\x1b[2J\n"]
TEXTS += ["(" * 5000, "x" * 10**6]
NUMBERS = [0, 1, -1, 2, 7, 10**9, 2**63, 10**30, 0.5, -0.5, math.nan, math.inf, 1e308]
OTHERS: list[Any] = [None, True, False, [], {}, [1], {"x": 1}, {"": None}]
VALUES: list[Callable[[], Any]] = [
    *(functools.partial(copy.copy, value) for value in [*TASKS, *TEXTS, *NUMBERS, *OTHERS]),
    lambda: nested(200),
    lambda: torch.zeros(()),
    lambda: torch.full((3,), torch.nan),
    lambda: torch.zeros(3, dtype=torch.complex64),
    lambda: wide(10**6, 10**6),
    lambda: torch.zeros(2, 2).to_sparse(),
    lambda: torch.zeros(2, device="meta"),
]


def places(value: Any, here: Path_ = ()) -> list[Path_]:
    """The places of the parts of a structure, six levels down."""
    found = [here]
    if len(here) == 6:
        return found
    if isinstance(value, dict):
        found += [place for key, part in value.items() for place in places(part, (*here, key))]
    elif isinstance(value, list | tuple):
        found += [place for i, part in enumerate(value) for place in places(part, (*here, i))]
    return found


def mutated(value: Any, rng: random.Random) -> Any:
    """The structure with one part replaced, left out, or put in another place."""
    chosen = rng.choice(places(value))
    if not chosen:
        return rng.choice(VALUES)()
    parent = value
    for step in chosen[:-1]:
        if isinstance(parent[step], tuple):
            parent[step] = list(parent[step])
        parent = parent[step]
    if isinstance(parent, tuple):
        return rng.choice(VALUES)()
    how = rng.random()
    if how < 0.2:
        del parent[chosen[-1]]
    elif how < 0.3 and isinstance(parent, dict):
        parent[rng.choice(["x", "", "..", 5])] = parent.pop(chosen[-1])
    elif how < 0.4 and isinstance(parent[chosen[-1]], torch.Tensor):
        parent[chosen[-1]] = wide(*(size * rng.choice([1, 2, 10**5]) for size in parent[chosen[-1]].shape))
    else:
        parent[chosen[-1]] = rng.choice(VALUES)()
    return value


def change_checkpoint(gift: Path, rng: random.Random) -> None:
    saved = torch.load(gift / "checkpoint.pt", weights_only=True)
    for _ in range(rng.choice([1, 1, 1, 3])):
        part = rng.choice(["all", "config", "flags", "parts"])
        if part == "all" or not isinstance(saved, dict) or not isinstance(saved.get("config"), dict):
            saved = mutated(saved, rng)
        elif part == "flags" and isinstance(saved["config"].get("flags"), dict):
            saved["config"]["flags"] = mutated(saved["config"]["flags"], rng)
        elif part in saved:
            saved[part] = mutated(saved[part], rng)
    if rng.random() < 0.05 and isinstance(saved, dict) and isinstance(saved.get("config"), dict):
        saved["config"]["x"] = doubled(40)
    torch.save(saved, gift / "checkpoint.pt")


def change_config(gift: Path, rng: random.Random) -> None:
    config = json.loads((gift / "config.json").read_text())
    for _ in range(rng.choice([1, 1, 3])):
        config = mutated(config, rng)
    try:
        text = json.dumps(config, default=str)
    except (RecursionError, MemoryError):
        text = "[" * 10**5
    (gift / "config.json").write_text(text if len(text) < 10**8 else "[" * 10**6)


def change_bytes(gift: Path, rng: random.Random) -> None:
    path = rng.choice([gift / name for name in ("checkpoint.pt", "config.json", "evaluations.csv")])
    content = bytearray(path.read_bytes())
    for _ in range(rng.choice([1, 3, 30])):
        content[rng.randrange(len(content))] = rng.randrange(256)
    path.write_bytes(content[: rng.choice([len(content), rng.randrange(len(content))])])


def change_table(gift: Path, rng: random.Random) -> None:
    lines = [line.split(",") for line in (gift / "evaluations.csv").read_text().splitlines()]
    for _ in range(rng.choice([1, 3])):
        line = rng.choice(lines)
        line[rng.randrange(len(line))] = rng.choice(["", "x", "nan", "inf", "-1", "1e400", '"', "9" * 400, "point"])
    (gift / "evaluations.csv").write_text("\n".join(map(",".join, lines)) + rng.choice(["\n", ""]))


def change_files(gift: Path, rng: random.Random) -> None:
    """Links, pipes, devices, and a checkpoint that is much larger than its file."""
    name = rng.choice(["checkpoint.pt", "config.json", "evaluations.csv", "film.gif", "episodes.csv"])
    path = gift / (name + rng.choice(["", "", ".new"]))
    path.unlink(missing_ok=True)
    how = rng.choice(["link", "pipe", "zeros", "folder", "packed"])
    if how == "link":
        path.symlink_to("../victim/file")
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "zeros":
        path.symlink_to("/dev/zero")
    elif how == "folder":
        path.mkdir()
    else:
        packed = io.BytesIO()
        torch.save({"config": torch.zeros(3 * 10**8, dtype=torch.uint8)}, packed)
        with zipfile.ZipFile(packed) as old, zipfile.ZipFile(gift / "checkpoint.pt", "w", zipfile.ZIP_DEFLATED) as new:
            for part in old.namelist():
                new.writestr(part, old.read(part))


CHANGES = [
    change_checkpoint,
    change_checkpoint,
    change_checkpoint,
    change_config,
    change_bytes,
    change_table,
    change_files,
]


def make_case(good: Path, case: Path, seed: int) -> tuple[str, list[str]]:
    """Makes a case's folder. Returns the program, as a module, and its command line."""
    rng = random.Random(seed)
    runs = sorted(path for path in good.iterdir() if path.is_dir())
    chosen = rng.choice(runs)
    for folder in ("work", "victim"):
        (case / folder).mkdir(parents=True)
    (case / "victim" / "file").write_text("mine")
    gift = Path(shutil.copytree(chosen, case / "gift", ignore=shutil.ignore_patterns("lock", "events*")))
    (gift / "checkpoint.previous.pt").unlink(missing_ok=True)
    for place in (case / "work", gift):
        (place / "evil.py").write_text("open('../victim/ran', 'w')\n")
    flags = json.loads((gift / "config.json").read_text())["flags"]
    algorithm = json.loads((gift / "config.json").read_text())["algorithm"]
    use = rng.choice(USES)
    short = ["--env", flags["env"], "--total-timesteps", str(flags["total_timesteps"]), "--eval-points", "2"]
    short += ["--eval-episodes", "2"]
    rng.choice(CHANGES)(gift, rng)
    if use == "collect":
        return "benchmark.collect", ["../gift", "--results", "results"]
    if use == "watch":
        return algorithm, ["--watch", "../gift", "--eval-episodes", "1"]
    if use == "start":
        short[3] = "500"  # a team's budget would take minutes
        return algorithm, [*short, "--start-from", "../gift", "--run-dir", "run"]
    (gift / "evil.py").unlink()
    return algorithm, [*short, "--run-dir", "../gift", "--resume"]


def run_case(module: str, words: list[str], case: Path) -> tuple[int, int]:
    """Runs a program in a process of its own. Returns its exit code, -9 where it took too long, and its memory."""
    process = os.fork()
    if process == 0:
        code: Any = 1
        try:
            os.chdir(case / "work")
            used = math.ceil(time.process_time())  # before the fork
            resource.setrlimit(resource.RLIMIT_CPU, (used + SECONDS, used + SECONDS))
            log = os.open(case / "log", os.O_WRONLY | os.O_CREAT)
            for stream in (1, 2):
                os.dup2(log, stream)
            sys.argv = [f"{module}.py", *words]
            program = sys.modules[module]
            if module == "benchmark.collect":
                program.main()
            else:
                names = ("__doc__", "Args", "paper_defaults", "train", "load")
                envs.runs.main(str(program.__file__), *(getattr(program, name) for name in names))
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    deadline = time.monotonic() + CLOCK
    while True:
        done, status, usage = os.wait4(process, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024
        if time.monotonic() > deadline:
            os.kill(process, signal.SIGKILL)
            deadline += 60
        time.sleep(0.01)


def main() -> None:
    """See the module's docstring."""
    good, folder = Path(sys.argv[1]), Path(sys.argv[2])
    torch.set_num_threads(1)
    for name in ("mappo", "iql", "coma", "benchmark.collect"):
        importlib.import_module(name)
    gc.freeze()  # or each case's collections would copy all that was imported
    for seed in range(int(sys.argv[3]), int(sys.argv[4]) + 1):
        case = folder / f"case{seed}"
        module, words = make_case(good, case, seed)
        code, memory = run_case(module, words, case)
        said = (case / "log").read_text(errors="replace")
        elsewhere = [path for path in case.iterdir() if path.name not in ("gift", "work", "victim", "log")]
        elsewhere += [path for path in (case / "victim").iterdir() if path.name != "file"]
        touched = (case / "victim" / "file").read_text() != "mine"
        if code not in (0, 2) or memory > MEMORY or "Traceback" in said or elsewhere or touched:
            found = f"exit code {code}, {memory / 2**20:.0f} MiB, {elsewhere or touched}"
            print(f"case {seed}: {module} {' '.join(words)}: {found}: {said[-600:]}", flush=True)
        else:
            shutil.rmtree(case)


if __name__ == "__main__":
    main()
