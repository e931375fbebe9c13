"""How a matrix game is drawn."""

import numpy as np
from numpy.typing import NDArray

from envs import render
from envs.families.matrix import EPISODE_LIMIT, Env

LIT, ROW, COLUMN = (255, 214, 102), (31, 105, 180), (204, 102, 0)  # the joint action, and who chose it


def frame(env: Env, index: int) -> NDArray[np.uint8]:
    """The payoff matrix of one sub-environment, with the last joint action lit.

    The row that agent 0 chose is blue at its edge, the column that agent 1 chose is orange.
    """
    cell, left, top, size = 120, 80, 128, len(env.payoffs)
    canvas = render.Canvas(left + size * cell + 20, top + size * cell + 20)
    canvas.text(20, 28, env.name, 26, anchor="lm")
    canvas.text(20, 64, f"step {env.steps[index]} / {EPISODE_LIMIT}", 26, anchor="lm")
    canvas.text(left + size * cell, 64, f"return {env.scores[index]:.0f}", 26, anchor="rm")
    row, column = env.chosen[index].tolist()
    for i in range(size):
        across, up = left + (i + 0.5) * cell, top + (i + 0.5) * cell
        canvas.text(left - 32, up, str(i), 30, ROW if i == row else render.LINES)
        canvas.text(across, top - 28, str(i), 30, COLUMN if i == column else render.LINES)
        for j in range(size):
            x, y = left + (j + 0.5) * cell, top + (i + 0.5) * cell
            lit = (i, j) == (row, column)
            canvas.square(x, y, cell / 2 - 6, LIT if lit else render.WHITE, render.LINES)
            canvas.text(x, y, str(env.payoffs[i][j]), 36)
    return canvas.frame()
