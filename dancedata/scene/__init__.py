"""Clips as drawings, motion from anything, pages that play it."""
