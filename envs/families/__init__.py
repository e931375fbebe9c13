"""The rules of the games: one module, or one package, for each family of tasks."""
