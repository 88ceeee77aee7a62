"""Watching a scene being trained: its snapshots in the view, the controls, curves and photos."""
