"""File formats that several datasets share: arrays, pickles, body models, BVH. No content is ever executed."""
