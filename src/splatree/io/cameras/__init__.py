"""Files of cameras, a module for each kind."""
