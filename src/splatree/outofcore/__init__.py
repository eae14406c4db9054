"""Scenes larger than memory: the tree of `build_lod`, bit for bit, built cell by cell through files."""
