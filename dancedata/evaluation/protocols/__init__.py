"""Plug-ins: named protocols, one file each."""
