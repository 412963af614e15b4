"""Engines that run units of work on the machines of a cluster."""
