"""User studies: pages of blind pairs, and their results."""
