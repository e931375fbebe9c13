"""How a board of level-based foraging is drawn."""

import numpy as np
from numpy.typing import NDArray

from envs import render
from envs.families.lbf import EPISODE_LIMIT, Env

APPLE, STALK, LEAF = (200, 45, 50), (110, 75, 45), (85, 140, 60)
AMBER, GREEN = (255, 185, 40), (60, 165, 85)  # the colours of loading without and with success


def frame(env: Env, index: int) -> NDArray[np.uint8]:
    """The board of one sub-environment: agents by number and colour, levels in the small discs, foods as apples.

    A band joins an agent to the food that it loads. It is amber if the levels do not suffice, and green if the food
    has been collected in this step; the food is then drawn hollow.
    """
    rows, columns = env.config.rows, env.config.columns
    cell = min(max(680 // max(rows, columns), 12), 64)
    margin, caption = 10, 34
    width, height = columns * cell + 2 * margin, rows * cell + margin + caption
    agents, foods, loading = env.game.agent[index], env.game.food[index], env.game.loading[index]
    canvas = render.Canvas(width, height)
    canvas.text(margin, caption / 2, f"step {env.game.steps[index]} / {EPISODE_LIMIT}", 15, anchor="lm")
    canvas.text(width - margin, caption / 2, f"return {env.game.score[index]:.2f}", 15, anchor="rm")
    for row in range(rows + 1):
        down = caption + row * cell
        canvas.line(margin, down, width - margin, down, render.LINES)
    for column in range(columns + 1):
        across = margin + column * cell
        canvas.line(across, caption, across, height - margin, render.LINES)

    def centre(place: NDArray[np.int64]) -> tuple[float, float]:
        return margin + (place[1] + 0.5) * cell, caption + (place[0] + 0.5) * cell

    for loader in np.flatnonzero(loading >= 0):
        food = foods[loading[loader]]
        colour = AMBER if food[2] > 0 else GREEN
        canvas.line(*centre(agents[loader]), *centre(food), colour, 0.36 * cell)
        canvas.square(*centre(agents[loader]), 0.5 * cell, colour)
    for f, food in enumerate(foods):
        x, y = centre(food)
        if food[2] > 0:
            canvas.line(x, y - 0.2 * cell, x + 0.05 * cell, y - 0.45 * cell, STALK, 0.07 * cell)
            canvas.circle(x + 0.13 * cell, y - 0.37 * cell, 0.09 * cell, LEAF)
            canvas.circle(x, y + 0.04 * cell, 0.37 * cell, APPLE)
            canvas.text(x, y + 0.04 * cell, str(food[2]), 0.52 * cell, render.WHITE)
        elif f in loading:
            canvas.circle(x, y, 0.34 * cell, render.PAPER, GREEN, 0.08 * cell)
    for i, agent in enumerate(agents):
        here = np.flatnonzero((agents[:, :2] == agent[:2]).all(axis=1))
        x, y = centre(agent)
        half = 0.41 * cell
        if len(here) > 1:  # agents that share a cell are drawn smaller, along its diagonal
            half = 0.3 * cell
            shift = (np.flatnonzero(here == i)[0] / (len(here) - 1) - 0.5) * 0.4 * cell
            x, y = x + shift, y - shift
        colour = render.AGENTS[i % len(render.AGENTS)]
        canvas.square(x, y, half, colour, render.WHITE, 0.03 * cell)
        canvas.text(x - 0.28 * half, y - 0.22 * half, str(i), 1.35 * half, render.WHITE)
        canvas.circle(x + 0.52 * half, y + 0.52 * half, 0.52 * half, render.WHITE, colour, 0.06 * half)
        canvas.text(x + 0.52 * half, y + 0.52 * half, str(agent[2]), 0.9 * half)
    return canvas.frame()
