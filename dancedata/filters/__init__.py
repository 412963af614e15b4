"""Plug-ins that choose the windows of a dataset."""
