"""Which of our security models stands for which of the paper's protocols, and why that is right.

Sources, MP-SPDZ (https://github.com/data61/MP-SPDZ):

- its README, "Dishonest majority", "Secret sharing": the table of programs and the paragraphs below it;
- ``Protocols/HemiShare.h``, ``TemiShare.h``, ``SohoShare.h`` (classes derived from ``SemiShare``, with its
  ``SemiMC`` for openings and its ``SemiInput``) and ``CowGearShare.h`` (derived from MASCOT's ``Share``, with
  its ``MAC_Check_`` and ``Input``): what such a class sets for itself is ``LivePrep``, where triples come
  from, and for products of matrices a way to prepare them whole.
"""

from __future__ import annotations

STANDS_FOR: dict[str, tuple[str, ...]] = {
    "malicious": ("MASCOT", "CowGear"),
    "semi-honest": ("Semi", "Hemi", "Temi", "Soho"),
    "cpp": ("Baseline",),
    "numpy": (),
}
"""Our protocols, and those of the paper that each stands for. NumPy's is the baseline in our language."""

PAPER_TRIALS = 6300
"""Seven protocols, nine lengths, ten scores, ten trials: Fishberg, Jia, How, "CILC"."""

STATEMENT = """\
The paper runs 6,300 trials: seven protocols, nine lengths, ten scores, ten trials of each. All times are of
the online phase, with the triples made beforehand. Its six MP-SPDZ protocols differ in how triples are made,
and there are two online phases among them, which are our two security models:

  malicious    stands for MASCOT and CowGear. Theirs: values are shared with MACs, products take Beaver
               triples, openings are MAC-checked. CowGear, which is covert, is LowGear with a covertly secure
               offline phase; online it does what MASCOT does. So 900 trials stand for 1,800.
  semi-honest  stands for Semi, Hemi, Temi and Soho. Theirs: values are shared without MACs, products take
               Beaver triples. Semi makes them by oblivious transfer (it is MASCOT without what malicious
               security needs), Hemi and Temi by semi-homomorphic, Soho by somewhat homomorphic encryption.
               So 900 trials stand for 3,600.
  cpp          is the paper's insecure baseline in C++: 900 trials for 900.
  numpy        is the same in Python: both send their descriptor in the clear, and NumPy computes. 900 more.

Ours have the security model of what they stand for, and another online protocol: in place of triples that
two parties make, a dealer trusted before the mission deals what the very program needs (masks, their
products, keys of comparisons), which is why bytes and rounds are so few. It is stored on tape and outside of
the measured time, as their triples are; tape bytes stand beside the others. Of MP-SPDZ mascot and hemi were
recorded; the others were not run.
Source: MP-SPDZ's README, "Dishonest majority", and Protocols/{CowGear,Hemi,Temi,Soho}Share.h."""
