"""Readers of published datasets and of folders of captures.

In each package: `reader` (the plug-in), `layout` (places of files), `load` (one motion file), `facts` (of the
dataset).
"""
