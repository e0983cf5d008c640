"""One robot's agent: what runs for the whole mission."""
