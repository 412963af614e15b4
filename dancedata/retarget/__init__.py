"""Motion on another skeleton: joint maps, scale, standing feet."""
