"""Segments of datasets: listed, written as files and replaced; events that are computed."""
