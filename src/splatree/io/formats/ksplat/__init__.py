"""The `.ksplat` of mkkellogg."""
