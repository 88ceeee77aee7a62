"""Selections, operations and clean-up in the window."""
