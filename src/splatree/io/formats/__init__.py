"""File formats, a folder each: reader, writer and container together."""
