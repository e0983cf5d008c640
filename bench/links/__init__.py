"""Comparisons under the links that robots have: thin, slow, far away, lossy."""
