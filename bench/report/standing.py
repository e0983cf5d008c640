"""Which of our models stands for which of the paper's protocols, in words."""

STANDING = (
    "The paper measures seven protocols; three stand here. malicious stands for MASCOT and CowGear: their "
    "online phase is SPDZ's with the same MAC check, and only the making of triples differs (CowGear's is "
    "covert). semi-honest stands for Semi, Hemi, Temi and Soho: Beaver triples without MACs online, and "
    "other ways to make them. The insecure baseline is C++.",
    "So 900 malicious trials stand for 1,800 of the paper's 6,300, 900 semi-honest ones for 3,600, and the "
    "baseline's 900 for themselves.",
)
