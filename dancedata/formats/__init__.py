"""File formats that several datasets share: arrays, pickles, body models, BVH. Nothing foreign is ever executed."""
