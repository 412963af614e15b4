"""BVH files (Biovision hierarchy): parsed, carried over to SMPL's joints, written."""
