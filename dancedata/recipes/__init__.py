"""Checked recipes, with instances of their plug-ins."""
