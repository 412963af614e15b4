"""Labels of feet on the ground. One file per contact rule."""
