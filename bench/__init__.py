"""Measurements: the sweep, the baselines beside it, the report, and the demo on real data."""
