"""A built dataset as the files of one trainer or program. One file per plug-in."""
