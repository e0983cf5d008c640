"""What every other room stands on: array types, the errors a caller may meet, the costs of a run."""
