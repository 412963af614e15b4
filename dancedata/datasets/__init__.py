"""Readers of published datasets and of folders of captures.

`published` is the base of the first, `checks` has what is checked in their files, `files` their folders and lists.
"""
