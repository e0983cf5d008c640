"""A guard of speed: ratios measured within one run, held to those that are committed."""
