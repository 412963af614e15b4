"""How work is run: units, executors, the cache, and the instructions that compute."""
