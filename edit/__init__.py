"""Editing a scene without touching it: selections, operations, history, recipes, pruning. Imports scene only."""
