"""What every run needs around its learning: of the file system, the terminal and the machine.

A script calls what is here in one line each, so that a reader of an algorithm need not read it:

    fast_mkl     faster matrix products on AMD processors, if this package is imported before PyTorch
    flags        Flags, filled, parse_flags, Range, make_for, check_teams, check_one_team
    run          Run, own_generator, evaluate, watch, main: see docs/how-to/around-a-training.md
    careful      careful: a trained team that looks at what it is given
    directory    RunDirectory, read_checkpoint, fitting_checkpoint: what a run keeps on the disk
    replay       EpisodeFile
    log          Log: progress bar, TensorBoard, progress.json
    process      StopSignals
    origin       provenance: where a result comes from
    terminal     one_sentence: how a program ends
"""

# ruff: noqa: F401 (these are the names for the scripts)

import sys
from pathlib import Path

import envs

if Path(envs.__file__ or "").parent != Path(__file__).parents[1]:  # a folder of that name where the program is
    theirs = next(iter(getattr(envs, "__path__", [envs.__file__])))
    print(f"{theirs} takes the place of this project's package envs: rename it, or start elsewhere.", file=sys.stderr)
    sys.exit(2)

from envs.runs import fast_mkl  # isort: skip (before whatever imports PyTorch)
from envs.runs.careful import careful
from envs.runs.directory import (
    RunDirectory,
    describe,
    file_name,
    fitting_checkpoint,
    last_checkpoint,
    place_arrived,
    put,
    read_checkpoint,
    run_path,
    safe_name,
    write_episodes,
    write_new,
    write_whole,
)
from envs.runs.flags import (
    OF_ONE_RUN,
    RANGES,
    Flags,
    Range,
    changed_flags,
    check_flags,
    check_one_team,
    check_teams,
    filled,
    make_for,
    parse_flags,
)
from envs.runs.log import Log, in_words
from envs.runs.memory import forgotten
from envs.runs.origin import provenance, script_hash
from envs.runs.process import StopSignals, Stopwatch, ends_with_parent, keep_freed_memory
from envs.runs.replay import EpisodeFile
from envs.runs.run import Run, evaluate, main, own_generator, watch
from envs.runs.terminal import KILLED, Parser, one_sentence, open_streams, say, with_flags
from envs.runs.valid import is_whole
