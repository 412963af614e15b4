"""Readers of published datasets and of folders of captures.

Every reader that is a package has the same files: `reader` (the plug-in, with the notes of its scan), `layout` (where
files are), `load` (one motion file) and `facts` (of the dataset or its files); further files have a subject of their
own, such as `people`. The tree on disk is in the docstring of each package. `files` and `examples` are shared.
"""
