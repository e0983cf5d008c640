"""In the clear, once a pair of places matched: 2-D submaps, their alignment, pose graphs."""
