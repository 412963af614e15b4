"""The parts of exports: checks of a dataset, the job, the folder that appears whole."""
