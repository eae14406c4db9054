"""Scenes moved, cropped, filtered and ordered: pure functions from a scene to a scene."""
