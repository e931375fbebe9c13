"""How each family of tasks is drawn, one file a family. `VectorEnv.frame` finds it; the rules know nothing of it."""
