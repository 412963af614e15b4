"""Recipes: what is asked for. YAML becomes a checked recipe whose plug-ins are made."""
