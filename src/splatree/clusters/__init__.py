"""Clusters of Gaussians: making them, and leaving them out of a view before anything of them is read."""
