"""File formats: arrays, pickles, body models, BVH. No content is ever executed."""
