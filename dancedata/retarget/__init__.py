"""Motion from one skeleton to another: joint maps, rest poses, scaled limbs, feet that stay on the floor."""
