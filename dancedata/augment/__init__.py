"""Plug-ins that copy train clips and change samples."""
