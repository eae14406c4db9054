"""The specification in NumPy float64: slow, short, obvious; no early exits but those of the definition."""
