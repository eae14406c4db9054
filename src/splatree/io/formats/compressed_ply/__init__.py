"""The `.compressed.ply` of PlayCanvas."""
