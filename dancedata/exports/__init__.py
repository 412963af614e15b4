"""Plug-ins: a built dataset as the files of one trainer or program, one file each."""
