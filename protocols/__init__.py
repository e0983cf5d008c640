"""What is computed: the score functions, and the candidate bit on top of them."""

from protocols.candidate import is_candidate
from protocols.scores import SCORES, Score

__all__ = ["SCORES", "Score", "is_candidate"]
