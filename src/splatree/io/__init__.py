"""Files ↔ scenes, cameras and pictures: a folder a format, the registry of all, and what reads and writes by it."""
