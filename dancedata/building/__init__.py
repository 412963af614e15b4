"""The spine of a build: takes of a source become clips."""
