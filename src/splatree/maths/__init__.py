"""Pure functions on arrays: rotations, covariance, harmonics, Morton codes."""
