"""Frozen structs of a scene and of a frame; no algorithms."""
