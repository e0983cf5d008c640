"""The kinds of place descriptors that a plan can name: D1 to D5 of the paper, and D5's ring key.

Names, lengths and scores are those of the table of global descriptors in Fishberg, Jia and How, "CILC". A
cosine there is S10 here, of vectors that the robot has brought to norm 1: truer and far cheaper than a cosine
inside (``docs/scores.md``). The thresholds are where public systems start; which one is right depends on
sensors, network and surroundings, and **has to be chosen on one's own data**. Every number can be overridden.
"""

from __future__ import annotations

from dataclasses import dataclass

_UNIT = 0.99
"""Smallest norm of what should have norm 1: one that was not normalised is told, float16 still passes."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of descriptors, and what it is compared with unless a plan says otherwise.

    Attributes:
        name: The paper's identifier.
        title: What it is.
        dim: Length of a descriptor.
        score: Score function.
        threshold: In the score's units.
        resolution: Fractional bits of the score that a comparison looks at; None for all.
        max_norm: Largest L2 norm.
        min_norm: Smallest L2 norm; the proof of it costs nothing.
    """

    name: str
    title: str
    dim: int
    score: str = "S10"
    threshold: float = 0.8
    resolution: int | None = 16
    max_norm: float = 1.0
    min_norm: float = _UNIT

    @property
    def label(self) -> str:
        """Its name and, in short, what it is: ``D5 (Scan Context)``."""
        return f"{self.name} ({self.title.partition(',')[0]})"


D1 = Kind("D1", "DBoW2, as square roots of a bag of words projected to 1,024 numbers", 1024, threshold=0.5)
"""The paper has the L1 distance of bags of 10^3 to 10^6 words, which is S1, or S2 of normalised bags.

S2 stores a key for every word of every pair, 1.5 KB: bags of 1,000 words are 1.5 MB a pair. So this is S10 of
what keeps that order: the square roots of the bag, divided by its sum, projected by public random signs to
1,024 numbers and brought to norm 1 (``docs/scores.md``, bags of words). Their product B is at least the
similarity s = 1 - L1 / 2, so that 0.5, the bag-of-words score of Kimera-Multi, keeps every pair that s >= 0.5
keeps, up to the projection (about 0.03), and some more. For the paper's own score: ``score = "S2"``, ``dim``
the number of words, a threshold for the distance; ``--plan`` tells the size first.
"""

D2 = Kind("D2", "NetVLAD, after PCA, whitening and normalisation", 4096)
"""4096 numbers as in the paper and in Arandjelovic et al. (CVPR 2016). 0.8 is the upper end of the inner
products that D2SLAM uses (0.6 to 0.8). DOOR-SLAM has 128 numbers and an L2 distance of 0.13: ``dim = 128``,
``threshold = 0.99155`` is the same.
"""

D3 = Kind("D3", "DINOv2, class token and mean patch token", 1536)
"""Two tokens of 768 numbers (ViT-B/14), the paper's own example; 2 x 384 (S), 2 x 1024 (L) and 2 x 1536 (g)
are ``dim = 768``, 2048 and 3072. No system has published a threshold: 0.8 is where Swarm-SLAM starts for the
cosine of its learned descriptors (0.8 to 0.9). DINO's raw tokens have a large common mean: subtract a public
mean before normalising.
"""

D4 = Kind("D4", "DINOv3, class token and mean patch token", 8192)
"""Two tokens of 4096 numbers (7B), the largest that the paper measures; 2 x 384 (S, S+), 2 x 768 (B),
2 x 1024 (L) and 2 x 1280 (H+) are ``dim = 768``, 1536, 2048 and 2560. The threshold as for D3.
"""

D5 = Kind("D5", "Scan Context, 20 rings by 60 sectors", 1200, threshold=0.42)
"""20 x 60 cells and the cosine as in the paper and in Kim and Kim (IROS 2018). 0.42 suits descriptors from
which a public mean was subtracted, as the demo's: all cells are non-negative, and raw ones match at 0.42
whatever they show; those need far more. A matrix that may be turned takes ``turns``.
"""

D5_KEY = Kind("D5-key", "Scan Context's ring key", 20, "S6", 0.1, max_norm=4.5, min_norm=0.5)
"""The share of occupied sectors in each of 20 rings: numbers from 0 to 1, so of a norm of at most sqrt(20).

The paper names the L1 distance for retrieval. S2 computes it and stores 34 KB a pair, so this is S6, the
squared Euclidean distance that Kim and Kim search by, at 0.4 KB; ``score = "S2"`` is there for who wants it.
They take the nearest keys and have no threshold; 0.1 is 20 rings that differ by 0.07 each. Nearly empty
scans, shorter than 0.5, are near to all other empty ones and are refused.
"""

KINDS = {kind.name: kind for kind in (D1, D2, D3, D4, D5, D5_KEY)}
"""All kinds, by name."""
