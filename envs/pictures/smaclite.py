"""How a battle is drawn."""

import numpy as np
from numpy.typing import NDArray

from envs import render
from envs.families.smaclite.environment import Env
from envs.families.smaclite.maps import SIZE, Polygon
from envs.families.smaclite.rules import NOBODY

WALL, GRAVE = (190, 186, 176), (170, 168, 162)
ALLY, ENEMY = (31, 105, 180), (200, 70, 30)
SHOT, BEAM = {ALLY: (120, 175, 230), ENEMY: (240, 150, 100)}, (60, 165, 85)
HEALTH, SHIELD = (60, 165, 85), (90, 150, 230)
AROUND = 3  # cells that are shown around the units
LETTERS = {
    "stalker": "S",
    "zealot": "Z",
    "zergling": "z",
    "marine": "m",
    "marauder": "M",
    "medivac": "+",
    "spine crawler": "C",
}


def frame(env: Env, index: int) -> NDArray[np.uint8]:
    """The battle of one sub-environment: units as discs with the letter of their type, allies blue, enemies red.

    Above a unit are bars of its hp (green) and its shield (blue); those that fly have a white edge. Lines join a
    unit to whom it has hit, or with a green one healed, in this step. Crosses are the dead.
    """
    units = env.game.unit[index]
    rows, columns = np.nonzero(env.game.walkable)
    corner = np.maximum([columns.min() - 1, rows.min() - 1], 0)
    map_size = np.minimum([columns.max() + 2, rows.max() + 2], SIZE) - corner
    width, height = map_size * (640 // map_size.max())  # in pixels
    # The picture shows the part of the map where units are, dead ones too. It grows in eighths of the map and moves
    # by two cells at once, so that it mostly stands still.
    spots = np.stack([units.x, units.y], axis=1)
    needed = (np.ptp(spots, axis=0) + 2 * AROUND) / map_size
    view_size = map_size * min(np.ceil(8 * needed.max()) / 8, 1)
    wanted = (spots.min(axis=0) + spots.max(axis=0) - view_size) / 2
    left, bottom = np.clip(2 * np.round(wanted / 2), corner, corner + map_size - view_size)
    top = bottom + view_size[1]
    cell, margin, caption = width / view_size[0], 10, 34
    canvas = render.Canvas(width + 2 * margin, height + margin + caption)

    def place(x: float, y: float) -> tuple[float, float]:
        return margin + (x - left) * cell, caption + (top - y) * cell

    def polygon(corners: Polygon, colour: render.Colour) -> None:
        points = [place(*corner) for corner in corners]
        canvas.pen.polygon([(x * render.DETAIL, y * render.DETAIL) for x, y in points], fill=colour)

    for wall in env.walls:
        polygon(wall, WALL)
    for frame in (  # what lies outside the part that is shown
        [(0, 0), (width + 2 * margin, caption)],
        [(0, 0), (margin, height + caption + margin)],
        [(width + margin, 0), (width + 2 * margin, height + caption + margin)],
        [(0, height + caption), (width + 2 * margin, height + caption + margin)],
    ):
        canvas.pen.rectangle([(x * render.DETAIL, y * render.DETAIL) for x, y in frame], fill=render.PAPER)
    canvas.text(margin, caption / 2, f"step {env.game.steps[index]} / {env.episode_limit}", 15, anchor="lm")
    canvas.text(margin + width / 2, caption / 2, env.name, 15)
    canvas.text(margin + width, caption / 2, f"return {env.game.score[index]:.2f}", 15, anchor="rm")

    places = [place(unit.x, unit.y) for unit in units]
    colours = [ALLY] * env.n_agents + [ENEMY] * (len(units) - env.n_agents)
    for unit, (x, y) in zip(units, places):
        if unit.hp == 0:
            half = 0.5 * unit.body * cell
            canvas.line(x - half, y - half, x + half, y + half, GRAVE, 2)
            canvas.line(x - half, y + half, x + half, y - half, GRAVE, 2)
    for unit, start, colour in zip(units, places, colours):
        if unit.shot != NOBODY:
            beam = BEAM if unit.heals else SHOT[colour]
            canvas.line(*start, *places[int(unit.shot)], beam, 3 if unit.heals else 1.5)
    for flying in (False, True):
        for unit, (x, y), colour, name in zip(units, places, colours, env.unit_names):
            if unit.hp == 0 or unit.flies != flying:
                continue
            radius = unit.body * cell
            canvas.circle(x, y, radius, colour, render.WHITE if flying else None, 1.5)
            canvas.text(x, y, LETTERS.get(name, name[:2]), 1.3 * radius, render.WHITE)
    for unit, (x, y) in zip(units, places):
        parts = [(unit.hp / unit.max_hp, HEALTH)]
        if unit.max_shield > 0:
            parts.append((unit.shield / unit.max_shield, SHIELD))
        length, level = 2 * unit.body * cell, y - unit.body * cell
        for part, colour in parts if unit.hp > 0 else ():
            level -= 3
            canvas.line(x - length / 2, level, x + length / 2, level, GRAVE, 2)
            if part > 0:
                canvas.line(x - length / 2, level, x + (part - 0.5) * length, level, colour, 2)
    return canvas.frame()
