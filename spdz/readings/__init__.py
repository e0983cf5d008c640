"""A program and what reads it: a party, on its tape or stock, the meter and the reading in the clear."""
