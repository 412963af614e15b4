"""Annotators: plug-ins, one file each."""
