"""User studies: pages of blind pairs, and what their results say."""
