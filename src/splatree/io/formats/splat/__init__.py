"""The `.splat` of antimatter15."""
