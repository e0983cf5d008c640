"""What a compromised robot gains: from descriptors in the clear, from private comparisons, and by probing."""
