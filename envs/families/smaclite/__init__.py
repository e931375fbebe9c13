"""Battles of small groups, in the manner of SMAC, the StarCraft multi-agent challenge (Samvelyan et al., 2019).

    smaclite-<map>[-sc2[-v2]]   2s_vs_1sc, 3s5z, MMM2, corridor, 3s_vs_5z (the paper's), 3m, 8m, 2s3z

This is our own simulator, written from a description of the rules, and needs no StarCraft. Without -sc2 it has the
rules of SMAClite (Michalski, Christianos and Albrecht, 2023), against whose battles it is checked. With -sc2 the same
engine has StarCraft's clock and data: `maps` has units, maps and all differences as tables. With -sc2-v2, on the four
maps with units that fight at close quarters (zealots and zerglings), these also surround; what is said of -sc2 holds
for both. `rules` and `walking` are what is played, `environment` has the class.

Each agent commands one unit; the enemies follow rules. Units are stalkers (s), zealots (z), a spine crawler (sc),
zerglings, and the marines, marauders and medivac of MMM2. Coordinates lie in 0 .. 32, x to the east, y to the north. A
step is 8 ticks of 1/16 s.

Actions: 0 nothing, for the dead and only for them; 1 stop; 2 north, 3 south, 4 east, 5 west: walk, for this step,
towards a point 2 away; 6 + k attack enemy k, or for a medivac heal ally k, until the next step: walk to it, shoot or
heal within reach. The mask allows a walk where the point 1 away is on the map and not in a wall, an attack on living
enemies up to 6 away (also those that the unit cannot hit: only some hit what flies), healing of living allies up to 6
away that are no healers themselves. Distances are between centres, except that of a weapon's reach, between edges.

Observation of a living agent (zeros for a dead one):
    whether it may walk north, south, east, west;
    of each enemy: whether it may be attacked, distance / 9, x and y relative to the agent / 9, hp, shield, type;
    of each other ally: 1, distance / 9, relative x and y / 9, hp, shield, type;
    its own hp, shield, type.
hp and shield are parts of their maximum, the type is a bit for each type that the map's table lists. Shields are left
out where a side has none, types where it has only one. Dead units, and those 9 away or more, are zeros. (For a medivac,
as in SMAC, "may be attacked" of enemy k is whether it may heal ally k.)
State: of each ally hp, cooldown of the weapon (a part of the whole or, with -sc2, of SMAC's constants; for a medivac
energy / 200), (x - 16) / 32, (y - 16) / 32, shield, type; of each enemy hp, x, y, shield, type, in the same way; zeros
for the dead; then each agent's last action, one bit for each action.

Reward, the same for all agents: the damage done to shields and hp of enemies, 10 for each killed, and 200 for the
victory, scaled such that an enemy side that does not regenerate is worth 20 in all. With -sc2 it is, as in SMAC, the
absolute difference of the enemies' health at the ends of a step, so that what they regenerate in a step is lost or,
when nobody shoots, even gained.
End: one side is dead, a termination; the map's own number of steps, a truncation. With -sc2 a side with nothing but
healers is dead, too, and a battle that nobody survives is not won. Statistics: battle_won, dead_allies, dead_enemies.

A tick has three phases:
    First, targets: an enemy keeps its target while that lives and is within reach, or attacks this enemy; only the
    spine crawler of -sc2 does not. Without one it takes the nearest of all that it can hit and that are within its
    sight (see the tables) or attack it. Without -sc2 healers come first, and as long as one lives, an enemy that does
    not attack a healer chooses anew in each tick. A healer of the enemies takes the weakest on the ground around it
    that is hurt or busy. An enemy without a target walks straight to the map's point of attack, a healer no faster
    than those around it. Agents' units do what they are told and nothing else.
    Then, ways: a unit that has its target within reach stands, and shoots if its weapon has cooled down; the others
    walk. With -sc2-v2 a unit of close quarters chooses, when it gets a target and at the start of each step, the
    nearest of 16 places around it at which it would touch nobody who stands; an enemy chooses among those around all
    whom it sees, and takes that one as its target. It walks straight there, but past whoever stands close in its way:
    along them, with the smallest turn that leads nearer to nobody, 120 degrees at most, and on the same side until its
    way is free. Units and walls are avoided as in ORCA, but a unit that stands does not give way.
    Last, in an order drawn anew for each tick, units move, regenerate and shoot.

A hit takes the damage (more on armoured units) from the shield, the rest, less the armour, from the hp. Shields regain
2 per second after 10 s without a hit, zerg 0.38 (0.273 with -sc2). A medivac gives 9 hp per second, 3 for a point of
energy, of which it has 50 and regains 0.5625 per second; without -sc2 it saves a patient killed in this very tick if
its turn comes after the shot. Weapons of -sc2 take a random -1 to 2 ticks longer to cool; besides that, only the order
within a tick is random: episodes begin all alike, and without -sc2 a team that does the same again lives through almost
the same again.
"""
