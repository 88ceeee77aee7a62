"""Editing in the window: the desk that edits pass over, the tools on the picture, and their panels."""
