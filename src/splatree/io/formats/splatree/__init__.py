"""The native `.splatree`: one file that holds all of a scene."""
