"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``."""
