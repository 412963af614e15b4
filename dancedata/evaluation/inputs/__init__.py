"""What can be evaluated: clips of stores, files of generated motion, clips of a dataset, arrays in memory."""
