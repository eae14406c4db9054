"""SOG, a folder or a bundle of pictures."""
