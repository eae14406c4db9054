"""Scenes with levels as web viewers stream them."""
