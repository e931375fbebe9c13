"""Runs a campaign: many runs of the scripts, as many at once as there are cores, collected as they finish.

    python benchmark/run.py --algorithms mappo ia2c --tasks lbf rware-tiny-4p --seeds 5 --sharing both [-- <flags>]
    python benchmark/run.py --algorithms all --tasks matrix --dry-run        what it would run, and how long that takes
    python benchmark/run.py --algorithms ia2c --tasks matrix-climbing --grid benchmark/grids/paper.csv       a search
    python benchmark/run.py --algorithms all --plan benchmark/seeds.csv      as many seeds as a plan gives each row

Runs that the results have are left out, runs that were interrupted go on, complete ones are collected. Ctrl-C stops
all of them at their next checkpoint, and the same command goes on. A run that fails leaves its output beside its
directory (log-seed<k>.txt), and the others go on. Exit code 0: the results have the whole plan; 1: they do not;
2: wrong input; 128 and the number of the signal: stopped.

A plan has the columns task, sharing and seeds; --tasks and --sharing choose among its rows. A row of mpe-adversary or
mpe-tag is one of the paper's tables, whose teams met opponents of the paper. It is run where its flags give that:
--plan benchmark/seeds.csv --tasks mpe-tag -- --env-kwargs "opponent='<file>'".

Flags behind -- are for the scripts, such as -- --total-timesteps 1000000. For clusters see
docs/how-to/campaign-on-many-machines.md.
"""

import argparse
import functools
import itertools
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
from tqdm import tqdm

import envs
from benchmark import measures, plan, store
from benchmark.campaign import SIGNALS, Campaign, Job, LocalJob, share_done
from benchmark.plan import PlannedRun
from envs.runs import Parser, one_sentence

GRID_SEEDS, SEEDS = 3, 5  # as in the paper
RESULTS_HELP = """where complete runs are collected; what is there counts as done. Default: benchmark/results, with the
committed results, or with --grid benchmark/searches/<grid>"""


def dry_run(runs: list[PlannedRun], results: Path, jobs: int) -> int:
    """Prints the plan, and what is left of it in core hours, from what runs of the same settings took. Gives the exit
    code: 1 where a run would fail, as with a damaged table of the results.
    """
    left: dict[tuple[str, str, str, str], list[float]] = {}  # timesteps of each run, by setting
    code = 0
    for run in runs:
        try:
            there, _ = store.condition(run, results)
        except (ValueError, OSError) as error:
            print(f"{run}: would fail, {error}")
            code = 1
            continue
        print(f"{run}: {there}")
        if there in ("new", "begun"):
            share = share_done(run.directory) if there == "begun" else 0.0
            setting = run.task, run.algorithm, run.sharing, store.trained(run.changed)
            left.setdefault(setting, []).append(run.total_timesteps * (1 - share))
    if not left:
        print("Nothing is left to run.")
        return code
    costs = store.step_costs(*{results, store.RESULTS})
    hours = {setting: sum(steps) * costs[setting] / 3600 for setting, steps in left.items() if setting in costs}
    print("\nCore hours, from the CPU seconds of the runs that the results have of the same setting:")
    for setting, steps in left.items():
        known = f"{hours[setting]:.2f} core hours" if setting in hours else "not known"
        changed = "" if setting[3] == store.PAPER_SETTING else f" with {setting[3]}"
        print(f"{' '.join(setting[:3])}{changed}: {len(steps)} run{'s' * (len(steps) != 1)}, {known}")
    if unknown := sorted({algorithm for _, algorithm, _, _ in left.keys() - hours.keys()}):
        print(
            f"\nNo run of {', '.join(unknown)} with this setting is in the results; one that is complete would tell. A "
            "copy costs about what its original does: name that with --algorithms, too."
        )
    if hours:
        total, number = sum(hours.values()), sum(len(left[setting]) for setting in hours)
        wait = tqdm.format_interval(total * 3600 / min(jobs, number))
        print(f"\nIn all {total:.1f} core hours, with --jobs {jobs} about {wait} (h:min:s).")
    return code


def parse() -> argparse.Namespace:
    """Reads the command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--algorithms",
        nargs="+",
        required=True,
        metavar="name",
        help=f"scripts of algos/ ({', '.join(plan.script_names())}), paths of others, or all",
    )
    parser.add_argument(
        "--tasks",
        nargs="+",
        metavar="name",
        help=f"tasks, families ({', '.join(store.PAPER_FAMILIES)}; smac: its five stand-ins) or all; "
        "default with --plan: its tasks",
    )
    parser.add_argument(
        "--sharing",
        choices=["shared", "independent", "both"],
        help="one network for all agents (default), one for each, or runs of both kinds (default with --plan)",
    )
    parser.add_argument("--seeds", type=int, help=f"how many, from 0 on; default {SEEDS}, {GRID_SEEDS} with --grid")
    parser.add_argument("--plan", type=Path, metavar="csv", help="how many seeds each task gets, such as seeds.csv")
    parser.add_argument("--grid", type=Path, metavar="csv", help="search: run every combination of these flags")
    parser.add_argument("--dry-run", action="store_true", help="only say what would run, and how long it would take")
    parser.add_argument("--jobs", type=int, help="runs at once; default: one for each core")
    parser.add_argument("--ray", metavar="address", help='run on this Ray cluster ("auto": the one of this machine)')
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are kept; default: runs")
    parser.add_argument("--results", type=Path, help=RESULTS_HELP)
    parser.add_argument("flags", nargs="*", help="flags for the scripts, behind --")
    args, unknown = parser.parse_known_args()
    if args.flags and not args.flags[0].startswith("-"):
        parser.error(f"{args.flags[0]!r} belongs to no flag; --seeds is how many there are, and --jobs one number, too")
    if unknown:
        parser.error(f"unknown: {' '.join(unknown)} (flags for the scripts go behind --)")
    if any(number is not None and number < 1 for number in (args.jobs, args.seeds)):
        parser.error("--jobs and --seeds must be positive")
    if args.plan and (args.seeds or args.grid):
        parser.error("--plan says how many seeds there are, and goes with neither --seeds nor --grid")
    if not (args.plan or args.tasks):
        parser.error("--tasks or --plan must say what to run")
    return args


def seeds_of_rows(args: argparse.Namespace) -> plan.Seeds:
    """How many seeds each task and sharing gets. InputError where nothing of a plan was chosen."""
    tasks = plan.chosen_tasks(args.tasks) if args.tasks else None
    both = [*store.SHARING.values()]
    if not args.plan:
        sharings = both if args.sharing == "both" else [args.sharing or store.SHARED]
        return dict.fromkeys(
            itertools.product(tasks or [], sharings), args.seeds or (GRID_SEEDS if args.grid else SEEDS)
        )
    sharings = [args.sharing] if args.sharing in both else both
    planned = plan.read_seeds(args.plan)
    chosen = {row: n for row, n in planned.items() if n and row[0] in (tasks or (row[0],)) and row[1] in sharings}
    if not chosen:
        raise envs.InputError(f"{args.plan} plans no seeds for these tasks with this sharing.")
    return chosen


def of_the_papers_tables(runs: list[PlannedRun]) -> list[PlannedRun]:
    """Those of a plan's runs that meet the paper's opponents, where a task has some; says what is left out. InputError
    where that is everything."""
    left = [run for run in runs if measures.paper_setting(run.task).items() <= run.changed.items()]
    for task in dict.fromkeys(run.task for run in runs if run not in left):
        print(
            f"Left out: {task}, a row of the plan against the paper's opponent, which --env-kwargs names (see --help)."
        )
    if not left:
        raise envs.InputError("nothing of the plan is left.")
    return left


def run_campaign(args: argparse.Namespace) -> int:
    """Plans, runs and reports; gives the exit code."""
    seeds = seeds_of_rows(args)
    results = args.results or (store.HERE / "searches" / args.grid.stem if args.grid else store.RESULTS)
    grid = plan.read_grid(args.grid) if args.grid else None
    scripts = plan.chosen_scripts(args.algorithms)
    runs = plan.make_plan(scripts, seeds, tuple(args.flags), grid, args.runs.resolve())
    if args.plan:
        runs = of_the_papers_tables(runs)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    jobs = args.jobs or cores
    if not args.results:
        print(
            f"Runs that {results} has count as done, and new ones are added to it; --results takes another folder.",
            file=sys.stderr,
        )
    if args.dry_run:
        return dry_run(runs, results, jobs)
    start: Callable[[PlannedRun], Job] = LocalJob
    places: Callable[[], int] = functools.partial(int, jobs)
    if args.ray:
        envs.optional("ray")
        from benchmark import cluster

        connection = cluster.Connection(args.ray, args.jobs)
        start, places = functools.partial(cluster.RayJob, cluster=connection), connection.places
    args.runs.mkdir(parents=True, exist_ok=True)
    store.lock(results)  # that it cannot be written is to be known before hours of runs
    campaign = Campaign(runs, results, start, places)
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT:  # nohup has SIGHUP ignored
            signal.signal(number, campaign.ask_to_stop)
    campaign.go_on()
    return campaign.report()


@one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    sys.exit(run_campaign(parse()))


if __name__ == "__main__":
    main()
