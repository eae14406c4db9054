"""The `.hier` of hierarchical 3DGS."""
