"""What the viewers of others choose to load and draw in a view, repeated from their sources."""
