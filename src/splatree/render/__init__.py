"""Frames of a scene: the pipeline, camera paths, video."""
