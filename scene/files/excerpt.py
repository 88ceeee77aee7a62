"""Quoting what a file says in a message of one line."""

from __future__ import annotations


def excerpt(text: str) -> str:
    """`text` quoted on one line, cut where long: for messages about files that may hold anything."""
    return ascii(text if len(text) <= 60 else text[:57] + "...")
