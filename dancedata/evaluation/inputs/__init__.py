"""Inputs of an evaluation: clips of stores, files of generated motion, clips of a dataset, arrays in memory."""
