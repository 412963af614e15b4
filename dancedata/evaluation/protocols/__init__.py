"""Plug-ins: named protocols, by the dataset that they are computed on."""
