"""Dance metrics by named protocol: what is measured, of which joints, at which rate, against which pool.

`protocols` holds one file a protocol; `protocol` what they are made of; `evaluate` computes a table.
"""
