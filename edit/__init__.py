"""Editing a scene without touching it: selections, operations, history, recipes. Imports scene only."""
