"""What the commands need of the terminal: their frame, guarded streams and progress lines."""
