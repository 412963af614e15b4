"""A synthetic dance corpus made from a seed: its plan, its dancer and its band. Nothing in it was captured."""
