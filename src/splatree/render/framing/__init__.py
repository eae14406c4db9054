"""The first picture of a scene that comes without cameras: the vertical, the focus, the place to stand."""
