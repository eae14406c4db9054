"""Experiments: the tables and figures of the papers, each a command, on any scene."""
