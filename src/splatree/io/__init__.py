"""Files ↔ scenes, cameras and pictures: one module a format, one registry (`splatree.io.registry`) of all."""
