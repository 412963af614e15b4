"""Dance metrics by named protocol.

`protocols` has one file per protocol, `protocol` their parts; `evaluate` computes a table.
"""
