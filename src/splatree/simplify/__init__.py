"""A scene with fewer Gaussians: radius thinning and merging."""
