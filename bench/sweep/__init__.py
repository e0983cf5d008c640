"""The paper's whole experiment with this engine: every protocol, length and score, with the floor of each."""
