"""Accuracy and effects in the window: what is approximated, what it costs, what the scene calls for."""
