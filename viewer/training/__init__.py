"""Watching and editing a training while it runs."""
