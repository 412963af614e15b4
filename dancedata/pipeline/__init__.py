"""Build, plan, check, diff: the stages in their order. No other package has that order."""
