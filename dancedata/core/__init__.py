"""Core types and pure functions of arrays. All other packages build on these, which import none of them."""
