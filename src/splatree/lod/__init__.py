"""Levels of detail: building the tree, choosing the cut."""
