"""Transforms: plug-ins, one file each."""
