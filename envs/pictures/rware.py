"""How a warehouse is drawn."""

import numpy as np
from numpy.typing import NDArray

from envs import render
from envs.families.rware import DOWN, EPISODE_LIMIT, LEFT, RIGHT, UP, Env, is_highway

PLACE = (236, 232, 223)  # where shelves can stand
SHELF_COLOUR, SHELF_EDGE = (196, 172, 140), (158, 132, 100)
WANTED, WANTED_EDGE = (255, 185, 40), (200, 120, 0)  # a requested shelf
GOAL, DELIVERED = (196, 228, 203), (70, 180, 75)


def frame(env: Env, index: int) -> NDArray[np.uint8]:
    """The warehouse of one sub-environment: agents by number and colour, each with a lamp in front.

    Requested shelves are amber, the others brown. An agent carries the shelf that has a frame of its colour;
    without a frame, it stands under the shelf. The goals have rings; a shelf delivered in this step is green.
    """
    game, rows, columns = env.game, env.config.rows, env.config.columns
    cell = min(max(720 // max(rows, columns), 28), 48)
    margin, caption = 10, 34
    width, height = columns * cell + 2 * margin, rows * cell + margin + caption
    canvas = render.Canvas(width, height)
    canvas.text(margin, caption / 2, f"step {game.steps[index]} / {EPISODE_LIMIT}", 15, anchor="lm")
    canvas.text(width - margin, caption / 2, f"deliveries {game.deliveries[index]:.0f}", 15, anchor="rm")

    def centre(row: int, column: int) -> tuple[float, float]:
        return margin + (column + 0.5) * cell, caption + (row + 0.5) * cell

    for row in range(rows):
        for column in range(columns):
            if not is_highway(env.config, row, column):
                canvas.square(*centre(row, column), 0.5 * cell, PLACE)
    for column in (columns // 2 - 1, columns // 2):
        canvas.square(*centre(rows - 1, column), 0.5 * cell, GOAL)
        canvas.circle(*centre(rows - 1, column), 0.3 * cell, None, DELIVERED, 0.06 * cell)
    for row in range(rows + 1):
        down = caption + row * cell
        canvas.line(margin, down, width - margin, down, render.LINES)
    for column in range(columns + 1):
        across = margin + column * cell
        canvas.line(across, caption, across, height - margin, render.LINES)

    for row, column, requested in game.shelf[index]:
        fill, edge = (WANTED, WANTED_EDGE) if requested else (SHELF_COLOUR, SHELF_EDGE)
        canvas.square(*centre(row, column), 0.4 * cell, fill, edge, 0.05 * cell)
    for i, (row, column, direction, load) in enumerate(game.agent[index].tolist()):
        x, y = centre(row, column)
        colour = render.AGENTS[i % len(render.AGENTS)]
        if game.agent_rewards[index, i] > 0:
            canvas.square(x, y, 0.4 * cell, DELIVERED)
        if load >= 0:
            canvas.square(x, y, 0.46 * cell, None, colour, 0.1 * cell)
        radius = (0.26 if load >= 0 else 0.31) * cell
        lamp_x = x + 0.36 * cell * ((direction == RIGHT) - (direction == LEFT))
        lamp_y = y + 0.36 * cell * ((direction == DOWN) - (direction == UP))
        canvas.circle(lamp_x, lamp_y, 0.15 * cell, render.WHITE, colour, 0.06 * cell)
        canvas.circle(x, y, radius, colour, render.WHITE, 0.04 * cell)
        canvas.text(x, y, str(i), 1.2 * radius, render.WHITE)
    return canvas.frame()
