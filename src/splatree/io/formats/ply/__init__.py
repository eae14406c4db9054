"""The `.ply` of 3DGS."""
