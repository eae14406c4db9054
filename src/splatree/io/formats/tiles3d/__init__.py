"""3D Tiles: `tileset.json` and glTF tiles."""
