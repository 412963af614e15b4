"""Builds: takes of a source, transformed, encoded as fields, cut into windows, judged by rules."""
