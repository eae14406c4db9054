"""The `.rad` of Spark, with its tree."""
