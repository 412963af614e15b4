"""Readers of published datasets and of folders of captures.

Every reader that is a package has the same files: `reader` (the plug-in), `layout` (where files are), `load` (one
motion file), `facts` (what is known about the dataset or its files), `notes` (sentences of a scan) and `example` (a
tiny source); further files have a subject of their own, such as `splits`. The tree on disk is in the docstring of
each package.
"""
