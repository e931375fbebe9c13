"""Makes docs/films/<task>-<algorithm>.webp, and its line in docs/films/films.csv, from a run that is complete
or from a team in benchmark/teams.

python tools/films.py <run directory> ...
"""

import argparse
import csv
import importlib
import json
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageSequence

ROOT = Path(__file__).resolve().parent.parent
FILMS = ROOT / "docs" / "films"
sys.path[:0] = [str(ROOT), str(ROOT / "algos")]
LARGEST = 500_000  # bytes
WIDTHS = (480, 400, 320, 240)  # pixels; the first that is small enough
FRAMES = 150

import envs  # noqa: E402


def write_webp(gif: Path, path: Path) -> tuple[int, int]:
    """Writes the first frames of a GIF as WebP, in the largest size that is allowed. Returns width and height."""
    with Image.open(gif) as film:
        frames, durations = [], []
        for frame in ImageSequence.Iterator(film):
            frames.append(frame.convert("RGB"))
            durations.append(frame.info.get("duration", 200))
            if len(frames) == FRAMES:
                break
    for width in [min(width, frames[0].width) for width in WIDTHS]:  # an enlarged picture is blurred
        height = round(frames[0].height * width / frames[0].width)
        small = [frame.resize((width, height), Image.Resampling.LANCZOS) for frame in frames]
        small[0].save(path, save_all=True, append_images=small[1:], duration=durations, loop=0, quality=70, method=4)
        if path.stat().st_size <= LARGEST:
            return width, height
    raise ValueError(f"{path} is larger than {LARGEST:,} bytes")


def make(directory: Path) -> dict[str, str]:
    """Films a run's team. Returns the film's line in films.csv."""
    config = json.loads((directory / "config.json").read_text(encoding="utf-8"))
    algorithm, task = config["algorithm"], config["flags"]["env"]
    team = importlib.import_module(algorithm).load(directory)
    env = envs.make(task, num_envs=1, copy=False, pictures=True)
    with tempfile.TemporaryDirectory() as folder:
        gif = Path(folder, "film.gif")
        print(envs.film(env, team, 0, gif))
        path = FILMS / f"{task}-{algorithm}.webp"
        width, height = write_webp(gif, path)
    with open(directory / "evaluations.csv", newline="", encoding="utf-8") as file:
        last = [*csv.DictReader(file)][-1]
    return {
        "film": path.name,
        "task": task,
        "algorithm": algorithm,
        "timesteps": last["timestep"],
        "return_mean": f"{float(last['return_mean']):.3f}",
        "width": str(width),
        "height": str(height),
    }


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directories", nargs="+", type=Path)
    made = [make(directory) for directory in parser.parse_args().directories]
    file = FILMS / "films.csv"
    known = {}
    if file.exists():
        with open(file, newline="", encoding="utf-8") as rows:
            known = {row["film"]: row for row in csv.DictReader(rows)}
    known |= {row["film"]: row for row in made}
    with open(file, "w", newline="", encoding="utf-8") as rows:
        writer = csv.DictWriter(rows, [*made[0]], lineterminator="\n")
        writer.writeheader()
        writer.writerows(known[name] for name in sorted(known))


if __name__ == "__main__":
    main()
