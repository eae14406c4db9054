"""The `.spz` of Niantic, versions 1 to 4."""
