"""The pipeline: recipes, plans, builds. The only place that knows the order of the stages."""
