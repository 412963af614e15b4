"""Units of work: executors, the cache, and the instructions that compute."""
