"""What builds levels and clusters: thinning, pairs, merging, visibility, K-means."""
