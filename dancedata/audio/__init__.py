"""Audio files as samples, and features of music. `signal` decodes and resamples; each feature is a package."""
