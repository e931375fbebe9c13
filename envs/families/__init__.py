"""The rules of the games: one module, or one package, for each family of tasks.

Here is what the names of tasks depend on, too. It is not in the families' own modules, because those import Numba.
"""

from pathlib import Path

PLACES_TRIED = 1000  # in level-based foraging, for the foods of an episode
OPPONENTS = Path(__file__).parent / "opponents"  # trained networks that play in tasks of MPE
