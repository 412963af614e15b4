"""Units of work: executors, the cache, processor instructions."""
