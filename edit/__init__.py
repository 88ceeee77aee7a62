"""Non-destructive editing: selections, operations, history, recipes. Imports scene only."""
