"""Pictures: a canvas to draw frames on, and films made of frames.

This module imports Pillow, so it is imported only where something is drawn.
"""

from __future__ import annotations

import io
import os
from collections import Counter
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from envs.vector import Info, InputError, VectorEnv

Colour = tuple[int, int, int]

PAPER: Colour = (250, 249, 246)
LINES: Colour = (221, 218, 210)
INK: Colour = (48, 50, 56)
WHITE: Colour = (255, 255, 255)
AGENTS: tuple[Colour, ...] = (  # dark enough for white text; colour-blind readers can tell the first ones apart
    (31, 105, 180),
    (204, 102, 0),
    (70, 20, 95),
    (0, 133, 121),
    (190, 55, 120),
    (110, 85, 60),
    (80, 90, 105),
    (150, 130, 0),
)
FRAMES_PER_SECOND = 5  # of a film
FILM_STEPS = 250  # a film shows so many, or one episode if that is longer: frames are kept in memory until the end
FILM_SECONDS = 30  # a film that would last longer shows more frames in a second
HELD = 4  # the end of an episode is shown so many times more, before the next one begins
AREA, AREAS = 100, 64  # of a film's palette: at least so many pixels are an area; at most so many colours are for areas
DETAIL = 4  # pictures are drawn this many times larger and then reduced, so that edges are smooth


@lru_cache
def font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font, which exists on every machine."""
    return ImageFont.load_default(size * DETAIL)


class Canvas:
    """A picture of width x height pixels. Coordinates are pixels from the top left corner and may be fractions."""

    def __init__(self, width: int, height: int) -> None:
        self.image = Image.new("RGB", (width * DETAIL, height * DETAIL), PAPER)
        self.pen = ImageDraw.Draw(self.image)

    def line(self, x0: float, y0: float, x1: float, y1: float, colour: Colour, width: float = 1) -> None:
        """A straight line."""
        ends = [x0 * DETAIL, y0 * DETAIL, x1 * DETAIL, y1 * DETAIL]
        self.pen.line(ends, fill=colour, width=max(1, round(width * DETAIL)))

    def circle(
        self,
        x: float,
        y: float,
        radius: float,
        fill: Colour | None = None,
        edge: Colour | None = None,
        width: float = 1,
    ) -> None:
        """A circle around (x, y), filled, with an edge, or both."""
        box = [(x - radius) * DETAIL, (y - radius) * DETAIL, (x + radius) * DETAIL, (y + radius) * DETAIL]
        self.pen.ellipse(box, fill=fill, outline=edge, width=max(1, round(width * DETAIL)))

    def square(
        self, x: float, y: float, half: float, fill: Colour | None = None, edge: Colour | None = None, width: float = 1
    ) -> None:
        """A square with round corners around (x, y); half: half the length of a side."""
        box = [(x - half) * DETAIL, (y - half) * DETAIL, (x + half) * DETAIL, (y + half) * DETAIL]
        self.pen.rounded_rectangle(
            box, 0.45 * half * DETAIL, fill=fill, outline=edge, width=max(1, round(width * DETAIL))
        )

    def text(self, x: float, y: float, text: str, size: float, colour: Colour = INK, anchor: str = "mm") -> None:
        """Text, `size` pixels high. (x, y) is its middle (anchor "mm"), its left end ("lm") or its right end ("rm")."""
        weight = 0.025 * size * DETAIL  # Pillow's own font is thin
        where = (x * DETAIL, y * DETAIL)
        self.pen.text(where, text, fill=colour, font=font(size), anchor=anchor, stroke_width=weight)

    def frame(self) -> NDArray[np.uint8]:
        """The picture, uint8 [height, width, 3]."""
        return np.asarray(self.image.reduce(DETAIL))


def common_palette(images: list[Image.Image]) -> Image.Image:
    """One palette for a whole film, so that colours do not flicker.

    A colour that fills an area in any frame is in it: what is seen in a few frames only, such as a touch, matters most.
    The rest of the 256 are for the edges between areas, from frames all over the film.
    """
    largest: Counter[Any] = Counter()  # the most pixels that a colour has in a frame
    for image in images:
        for pixels, colour in image.getcolors(image.width * image.height) or []:
            largest[colour] = max(largest[colour], pixels)
    areas = [colour for colour, pixels in largest.most_common(AREAS) if pixels >= AREA]
    sample = images[:: max(1, len(images) // 8)]
    strip = Image.new("RGB", (images[0].width, images[0].height * len(sample)))
    for i, image in enumerate(sample):
        strip.paste(image, (0, i * image.height))
    colours = strip.quantize(256 - len(areas), dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in areas for value in colour] + colours[: 3 * (256 - len(areas))])
    return palette


def save_film(
    frames: Iterable[NDArray[np.uint8]],
    path: str | os.PathLike[str],
    frames_per_second: float = FRAMES_PER_SECOND,
) -> None:
    """Write frames, uint8 [height, width, 3] and all of one size, as a GIF that repeats for ever.

    The last frame stays for a second, so that the end is seen before the film starts again. Where the path is that of a
    link, the film takes the link's place, and what it leads to stays as it is.
    Raises InputError if there is no frame or if the sizes differ.
    """
    images = [Image.fromarray(frame) for frame in frames]
    if not images:
        raise InputError("a film needs at least one frame.")
    if any(image.size != images[0].size for image in images):
        sizes = " and ".join(f"{width} x {height}" for width, height in sorted({image.size for image in images}))
        raise InputError(f"the frames of a film must be of one size, and these have {sizes} pixels.")
    palette = common_palette(images)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    hundredths = max(round(100 / frames_per_second), 2)  # the unit of a GIF; viewers show nothing faster than 2
    duration = [10 * hundredths] * (len(images) - 1) + [1000]
    film = io.BytesIO()
    images[0].save(film, format="GIF", save_all=True, append_images=images[1:], duration=duration, loop=0)
    Path(path).unlink(missing_ok=True)
    Path(path).write_bytes(film.getvalue())


class Team(Protocol):
    """Agents at play, as the `load` of every script returns them."""

    def reset(self) -> None:
        """Forget the last episode."""

    def act(self, observations: NDArray[np.float32], info: Info) -> NDArray[np.int64]:
        """Actions, [num_envs, n_agents]."""


def film(env: VectorEnv, team: Team, seed: int, path: str | os.PathLike[str], episodes: int = 5) -> None:
    """Play an episode drawn from the seed in each sub-environment; save the first few, one after the other, as a GIF.

    episodes: at most so many are shown; fewer, but at least one, where they are long (see FILM_STEPS).
    Raises ValueError if the family has no pictures.
    """
    observations, info = env.reset(seed=seed)
    team.reset()
    shown = range(min(episodes, env.num_envs, max(FILM_STEPS // env.episode_limit, 1)))
    frames = [[env.frame(index)] for index in shown]
    ended = np.zeros(env.num_envs, bool)
    while not ended.all():
        observations, _, terminated, truncated, info = env.step(team.act(observations, info))
        for index in shown:
            if not ended[index]:
                frames[index].append(env.frame(index))
        ended = terminated | truncated
    all_frames = [frame for episode in frames for frame in (*episode, *[episode[-1]] * HELD)]
    save_film(all_frames, path, max(FRAMES_PER_SECOND, len(all_frames) / FILM_SECONDS))
