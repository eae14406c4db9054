"""What file formats need: columns, quantisation, palettes, rotation of harmonics."""
