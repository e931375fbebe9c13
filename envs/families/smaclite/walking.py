"""How units walk without collisions.

Optimal reciprocal collision avoidance (van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance",
2011), among units that stand immovable. Each neighbour and each wall allows a half-plane of velocities; a unit takes
the allowed velocity nearest to the one that it wants.

A line of `State.line` is a point and a direction; allowed is what lies on it or to the left of it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.families.kernels import compiled
from envs.families.smaclite.maps import SIZE, Polygon

TICK = 1 / 16  # seconds
PARALLEL = 1e-5
EDGE = np.dtype(
    [
        ("ax", float),  # where it starts; the wall lies to the left of it
        ("ay", float),
        ("bx", float),  # where it ends
        ("by", float),
        ("tx", float),  # its direction
        ("ty", float),
        ("before_x", float),  # the direction of the edge before, and of the one after
        ("before_y", float),
        ("after_x", float),
        ("after_y", float),
        ("left", float),  # a box around the wall
        ("bottom", float),
        ("right", float),
        ("top", float),
    ]
)


def edges_of(wall: Polygon) -> list[tuple[float, ...]]:
    """Records of the kind EDGE."""
    corners = np.array(wall, float)
    ends = np.roll(corners, -1, axis=0)
    directions = (ends - corners) / np.linalg.norm(ends - corners, axis=1, keepdims=True)
    before, after = np.roll(directions, 1, axis=0), np.roll(directions, -1, axis=0)
    box = np.tile([*corners.min(axis=0), *corners.max(axis=0)], (len(wall), 1))
    return [tuple(row) for row in np.hstack([corners, ends, directions, before, after, box])]


def edges_near_cells(edge: Any, distance: float) -> NDArray[np.int64]:
    """For each cell, [row, column], the edges of walls nearer than the distance; then -1."""
    low = np.arange(SIZE)[:, None]
    across = np.maximum(0, np.maximum(edge.left - low - 1, low - edge.right))  # [column, edge]
    up = np.maximum(0, np.maximum(edge.bottom - low - 1, low - edge.top))  # [row, edge]
    near = up[:, None] ** 2 + across[None] ** 2 < distance**2  # [row, column, edge]
    numbers = np.full((SIZE, SIZE, max(near.sum(axis=2).max(initial=0), 1)), -1)
    for row in range(SIZE):
        for column in range(SIZE):
            found = np.flatnonzero(near[row, column])
            numbers[row, column, : len(found)] = found
    return numbers


@compiled
def squared_distance(me, other):
    """Between the centres of two units."""
    across, up = other.x - me.x, other.y - me.y
    return across * across + up * up


@compiled
def det(ax, ay, bx, by):
    """Positive where b points to the left of a."""
    return ax * by - ay * bx


@compiled
def avoid_collisions(unit, i, largest, edge, near_edges, near, distance, line, projected):
    """The velocity for this tick. Who wants to stand, stands, whoever pushes."""
    me = unit[i]
    x, y = me.wanted_x, me.wanted_y
    if x != 0 or y != 0:
        n_walls = 0
        if not me.flies:
            n_walls = lines_of_walls(me, edge, near_edges, line)
        n_lines = lines_of_units(unit, i, largest, near, distance, line, n_walls)
        violated, x, y = best_velocity(line, n_lines, me.speed, x, y, False)
        if violated < n_lines:
            x, y = least_collision(line, projected, n_walls, n_lines, violated, me.speed, x, y)
    me.chosen_x, me.chosen_y = x, y


@compiled
def lines_of_units(unit, i, largest, near, distance, line, n_lines):
    """Append a line for each unit about to touch this one, nearest first; returns the number of lines.

    The velocities, relative to the neighbour, that lead to a collision within a second form a cone with a round tip.
    The line goes through the nearest velocity outside, or half of the way to it where the neighbour moves and so does
    the other half. Units that overlap part within a tick.
    """
    me = unit[i]
    farthest = (me.body + largest) ** 2
    n_near = 0
    for j in range(len(unit)):
        other = unit[j]
        squared = squared_distance(me, other)
        if squared > farthest or j == i or other.hp == 0 or other.flies != me.flies:
            continue
        place = n_near
        while place > 0 and distance[place - 1] > squared:
            distance[place] = distance[place - 1]
            near[place] = near[place - 1]
            place -= 1
        distance[place] = squared
        near[place] = j
        n_near += 1

    for place in range(n_near):
        other, squared = unit[near[place]], distance[place]
        to_x, to_y = other.x - me.x, other.y - me.y
        relative_x, relative_y = me.velocity_x - other.velocity_x, me.velocity_y - other.velocity_y
        together = me.body + other.body
        touching = squared <= together * together
        per_second = 1 / TICK if touching else 1.0
        # From the centre of the round tip to the relative velocity
        out_x, out_y = relative_x - per_second * to_x, relative_y - per_second * to_y
        length = math.sqrt(out_x * out_x + out_y * out_y)
        ahead = out_x * to_x + out_y * to_y
        if touching or (ahead < 0 and ahead * ahead > together * together * length * length):
            to_go = together * per_second - length
            if length == 0:  # all ways out are as far
                out_x, length = 1.0, 1.0
            out_x, out_y = out_x / length, out_y / length
            direction_x, direction_y = out_y, -out_x
            change_x, change_y = to_go * out_x, to_go * out_y
        else:
            leg = math.sqrt(squared - together * together)
            if det(to_x, to_y, out_x, out_y) > 0:
                direction_x = (to_x * leg - to_y * together) / squared
                direction_y = (to_y * leg + to_x * together) / squared
            else:
                direction_x = -(to_x * leg + to_y * together) / squared
                direction_y = -(to_y * leg - to_x * together) / squared
            along = relative_x * direction_x + relative_y * direction_y
            change_x, change_y = along * direction_x - relative_x, along * direction_y - relative_y
        share = 0.5 if other.wanted_x != 0 or other.wanted_y != 0 else 1.0
        x, y = me.velocity_x + share * change_x, me.velocity_y + share * change_y
        n_lines = append_line(line, n_lines, x, y, direction_x, direction_y)
    return n_lines


@compiled
def lines_of_walls(me, edge, near_edges, line):
    """The lines of the walls that this unit could touch within a second; returns their number."""
    column = min(max(math.floor(me.x), 0), SIZE - 1)
    row = min(max(math.floor(me.y), 0), SIZE - 1)
    farthest = me.body + me.speed
    n_lines = 0
    for place in range(near_edges.shape[2]):
        k = near_edges[row, column, place]
        if k < 0:
            break
        one = edge[k]
        across = max(one.left - me.x, me.x - one.right, 0.0)
        up = max(one.bottom - me.y, me.y - one.top, 0.0)
        if across * across + up * up < farthest * farthest:
            n_lines = line_of_edge(me, one, line, n_lines)
    return n_lines


@compiled
def line_of_edge(me, edge, line, n_lines):
    """Append the line of one edge of a wall, if it has one; returns the number of lines.

    Velocities that lead into the edge, as thick as the unit, within a second are forbidden: they form a wedge between
    two legs, cut off by the edge. The line touches this region where it is nearest to the velocity of the last tick.
    """
    r, vx, vy = me.body, me.velocity_x, me.velocity_y
    # From here on all is relative to the unit: a the start of the edge, b its end, t its direction.
    ax, ay = edge.ax - me.x, edge.ay - me.y
    bx, by = edge.bx - me.x, edge.by - me.y
    tx, ty = edge.tx, edge.ty
    height = det(tx, ty, ax, ay)  # of the unit above the outer side
    if height <= 0:
        return n_lines
    for other in range(n_lines):  # behind an earlier line?
        px, py, dx, dy = line[other, 0], line[other, 1], line[other, 2], line[other, 3]
        a_behind = det(ax - px, ay - py, dx, dy) - r >= -PARALLEL
        if a_behind and det(bx - px, by - py, dx, dy) - r >= -PARALLEL:
            return n_lines
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    before_a = ax * tx + ay * ty > 0
    after_b = bx * tx + by * ty < 0

    if before_a and a2 <= r * r:
        length = math.sqrt(a2)
        return append_line(line, n_lines, 0.0, 0.0, -ay / length, ax / length)
    if after_b and b2 <= r * r:
        if det(bx, by, edge.after_x, edge.after_y) < 0:
            return n_lines
        length = math.sqrt(b2)
        return append_line(line, n_lines, 0.0, 0.0, -by / length, bx / length)
    if not before_a and not after_b and height <= r:
        return append_line(line, n_lines, 0.0, 0.0, -tx, -ty)

    # The legs; a unit that sees the edge from its end has both at the one corner.
    before_x, before_y, after_x, after_y = edge.before_x, edge.before_y, edge.after_x, edge.after_y
    corner = height <= r
    if corner and before_a:
        bx, by, b2 = ax, ay, a2
        after_x, after_y = tx, ty
    elif corner:
        ax, ay, a2 = bx, by, b2
        before_x, before_y = tx, ty
    tangent = math.sqrt(a2 - r * r)
    left_x, left_y = (ax * tangent - ay * r) / a2, (ay * tangent + ax * r) / a2
    tangent = math.sqrt(b2 - r * r)
    right_x, right_y = (bx * tangent + by * r) / b2, (by * tangent - bx * r) / b2
    # Where the neighbouring edge is in front of a leg, its direction takes the leg's place, and the line is its own.
    left_foreign = det(left_x, left_y, -before_x, -before_y) >= 0
    if left_foreign:
        left_x, left_y = -before_x, -before_y
    right_foreign = det(right_x, right_y, after_x, after_y) <= 0
    if right_foreign:
        right_x, right_y = after_x, after_y

    # Where is the velocity nearest to the region: at a corner, the edge or a leg?
    from_a_x, from_a_y, from_b_x, from_b_y = vx - ax, vy - ay, vx - bx, vy - by
    cx, cy = bx - ax, by - ay
    on_edge = 0.5
    if not corner:
        on_edge = (from_a_x * cx + from_a_y * cy) / (cx * cx + cy * cy)
    on_left = from_a_x * left_x + from_a_y * left_y
    on_right = from_b_x * right_x + from_b_y * right_y
    if (on_edge < 0 and on_left < 0) or (corner and on_left < 0 and on_right < 0):
        return append_tangent(line, n_lines, ax, ay, from_a_x, from_a_y, r)
    if on_edge > 1 and on_right < 0:
        return append_tangent(line, n_lines, bx, by, from_b_x, from_b_y, r)
    to_edge, to_left, to_right = math.inf, math.inf, math.inf
    if not corner and 0 <= on_edge <= 1:
        to_edge = (from_a_x - on_edge * cx) ** 2 + (from_a_y - on_edge * cy) ** 2
    if on_left >= 0:
        to_left = (from_a_x - on_left * left_x) ** 2 + (from_a_y - on_left * left_y) ** 2
    if on_right >= 0:
        to_right = (from_b_x - on_right * right_x) ** 2 + (from_b_y - on_right * right_y) ** 2
    if to_edge <= to_left and to_edge <= to_right:
        return append_line(line, n_lines, ax + r * ty, ay - r * tx, -tx, -ty)
    if to_left <= to_right:
        if left_foreign:
            return n_lines
        return append_line(line, n_lines, ax - r * left_y, ay + r * left_x, left_x, left_y)
    if right_foreign:
        return n_lines
    return append_line(line, n_lines, bx + r * right_y, by - r * right_x, -right_x, -right_y)


@compiled
def append_line(line, n_lines, x, y, direction_x, direction_y):
    """Returns the number of lines."""
    line[n_lines, 0] = x
    line[n_lines, 1] = y
    line[n_lines, 2] = direction_x
    line[n_lines, 3] = direction_y
    return n_lines + 1


@compiled
def append_tangent(line, n_lines, x, y, out_x, out_y, r):
    """The line that touches the circle of radius r around (x, y) in the direction of `out`; returns their number."""
    length = math.sqrt(out_x * out_x + out_y * out_y)
    out_x, out_y = out_x / length, out_y / length
    return append_line(line, n_lines, x + r * out_x, y + r * out_y, out_y, -out_x)


@compiled
def best_on_line(line, i, speed, x, y, farthest):
    """The best velocity on line i, not faster than speed and allowed by all lines before: (found, x, y).

    Best is what is nearest to (x, y) or, with `farthest`, what goes farthest in the direction of (x, y).
    """
    px, py, dx, dy = line[i, 0], line[i, 1], line[i, 2], line[i, 3]
    middle = -(px * dx + py * dy)
    squared = middle * middle + speed * speed - px * px - py * py
    if squared < 0:
        return False, x, y
    half = math.sqrt(squared)
    low, high = middle - half, middle + half
    for j in range(i):
        denominator = det(dx, dy, line[j, 2], line[j, 3])
        numerator = det(line[j, 2], line[j, 3], px - line[j, 0], py - line[j, 1])
        if abs(denominator) <= PARALLEL:
            if numerator < 0:
                return False, x, y
        elif denominator > 0:
            high = min(high, numerator / denominator)
        else:
            low = max(low, numerator / denominator)
        if low > high:
            return False, x, y
    along = min(max(dx * (x - px) + dy * (y - py), low), high)
    if farthest:
        along = high if dx * x + dy * y > 0 else low
    return True, px + along * dx, py + along * dy


@compiled
def best_velocity(line, n_lines, speed, want_x, want_y, farthest):
    """The best velocity under the first n_lines lines: (the line that leaves nothing, or n_lines; x, y).

    Lines are added one by one: where one forbids the best velocity so far, the new one lies on it.
    """
    x, y = want_x, want_y
    if farthest:
        x, y = x * speed, y * speed
    elif x * x + y * y > speed * speed:
        length = math.sqrt(x * x + y * y)
        x, y = speed * x / length, speed * y / length
    for i in range(n_lines):
        if det(line[i, 2], line[i, 3], line[i, 0] - x, line[i, 1] - y) > 0:
            found, new_x, new_y = best_on_line(line, i, speed, want_x, want_y, farthest)
            if not found:
                return i, x, y
            x, y = new_x, new_y
    return n_lines, x, y


@compiled
def least_collision(line, projected, n_walls, n_lines, begin, speed, x, y):
    """In a crowd that leaves no velocity: the one that violates the lines of units least, but none of walls."""
    worst = 0.0
    for i in range(begin, n_lines):
        px, py, dx, dy = line[i, 0], line[i, 1], line[i, 2], line[i, 3]
        if det(dx, dy, px - x, py - y) <= worst:
            continue
        for j in range(n_walls):
            append_line(projected, j, line[j, 0], line[j, 1], line[j, 2], line[j, 3])
        n_projected = n_walls
        for j in range(n_walls, i):  # where lines i and j are violated alike
            qx, qy, other_x, other_y = line[j, 0], line[j, 1], line[j, 2], line[j, 3]
            angle = det(dx, dy, other_x, other_y)
            if abs(angle) > PARALLEL:
                along = det(other_x, other_y, px - qx, py - qy) / angle
                x_alike, y_alike = px + along * dx, py + along * dy
            elif dx * other_x + dy * other_y > 0:
                continue
            else:
                x_alike, y_alike = (px + qx) / 2, (py + qy) / 2
            turn_x, turn_y = other_x - dx, other_y - dy
            length = math.sqrt(turn_x * turn_x + turn_y * turn_y)
            n_projected = append_line(projected, n_projected, x_alike, y_alike, turn_x / length, turn_y / length)
        violated, new_x, new_y = best_velocity(projected, n_projected, speed, -dy, dx, True)
        if violated == n_projected:
            x, y = new_x, new_y
        worst = det(dx, dy, px - x, py - y)
    return x, y
