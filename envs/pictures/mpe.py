"""How the particle environments are drawn."""

import numpy as np
from numpy.typing import NDArray

from envs import render
from envs.families.mpe import EPISODE_LIMIT, PREY, SPEAKER, SPREAD, TAG, Env

CALM, GOAL, TOUCH = (165, 163, 156), (60, 165, 85), (205, 45, 55)  # landmarks, the goal, agents that touch


def frame(env: Env, index: int) -> NDArray[np.uint8]:
    """One sub-environment: team 0 in blue, team 1 in orange, landmarks grey, the goal green, lines for velocities.

    Agents that touch another have a red rim. The speaker is a square; a bubble has the symbol that it said. The
    grey frame goes from -1 to 1; where an agent is far outside, the picture shows more of the plane.
    """
    side, caption = 560, 34
    agents, landmarks = env.game.agent_position[index], env.game.landmark_position[index]
    farthest = max(np.abs(agents).max(), np.abs(landmarks).max())
    shown = max(1.25, np.ceil(4 * farthest + 1) / 4)  # half of the side; in quarters, so that a film is calm
    scale = side / (2 * shown)
    canvas = render.Canvas(side, side + caption)

    def pixel(place: NDArray[np.float64]) -> tuple[float, float]:
        return side / 2 + scale * place[0], caption + side / 2 - scale * place[1]

    corners = [pixel(np.array(corner)) for corner in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for corner, following in zip(corners, corners[1:] + corners[:1]):
        canvas.line(*corner, *following, render.LINES, 2)
    for k, place in enumerate(landmarks):
        colour = GOAL if k == env.game.goal[index] else CALM
        canvas.circle(*pixel(place), max(scale * env.config.landmark_radius, 7), colour)

    n_agents = len(agents)
    apart = np.linalg.norm(agents[:, None] - agents, axis=2)
    touching = (apart < env.config.radius[:, None] + env.config.radius) & ~np.eye(n_agents, dtype=bool)
    if env.config.scenario == TAG:  # what counts is the prey
        touching[:PREY, :PREY] = False
    collides = env.config.scenario in (SPREAD, TAG)
    for i, place in enumerate(agents):
        colour = render.AGENTS[env.team_of[i]]
        edge = TOUCH if collides and touching[i].any() else render.WHITE
        radius = max(scale * env.config.radius[i], 9)
        x, y = pixel(place)
        ahead = pixel(place + 0.3 * env.game.agent_velocity[index, i])  # where it would come to rest
        canvas.line(x, y, *ahead, colour, 3)
        if env.config.acceleration[i] == 0:
            canvas.square(x, y, radius, colour, edge, 2)
        else:
            canvas.circle(x, y, radius, colour, edge, 4 if edge == TOUCH else 2)
    for k, place in enumerate(landmarks):  # once more, so that one is seen under an agent
        colour, width = (GOAL, 4) if k == env.game.goal[index] else (CALM, 2)
        canvas.circle(*pixel(place), max(scale * env.config.landmark_radius, 7), None, colour, width)
    for i, place in enumerate(agents):
        canvas.text(*pixel(place), str(i), min(max(1.3 * scale * env.config.radius[i], 12), 24), render.WHITE)
    if env.game.symbol[index] >= 0:
        x, y = pixel(agents[SPEAKER])
        canvas.line(x + 12, y - 13, x + 24, y - 26, render.INK, 2)  # not over its number
        canvas.circle(x + 28, y - 32, 14, render.WHITE, render.INK, 2)
        canvas.text(x + 28, y - 32, "ABC"[env.game.symbol[index]], 17)

    canvas.text(10, caption / 2, f"step {env.game.steps[index]} / {EPISODE_LIMIT}", 15, anchor="lm")
    canvas.text(side - 10, caption / 2, f"return {env.game.score[index]:.2f}", 15, anchor="rm")
    return canvas.frame()
