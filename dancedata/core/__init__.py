"""Shared values, base classes of plug-ins, pure functions. All packages build on these, which import none."""
