"""The spine of a build: takes of a source become clips to store."""
