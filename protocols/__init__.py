"""What is computed: the score functions, the candidate bit on top of them, all pairs of two robots."""

from protocols.batch import Block, Matches
from protocols.candidate import is_candidate
from protocols.gallery import Gallery
from protocols.matcher import Matcher
from protocols.matching import match
from protocols.place_purpose import Part, PlacePurpose
from protocols.scores import SCORES, Score

__all__ = [
    "SCORES",
    "Block",
    "Gallery",
    "Matcher",
    "Matches",
    "Part",
    "PlacePurpose",
    "Score",
    "is_candidate",
    "match",
]
