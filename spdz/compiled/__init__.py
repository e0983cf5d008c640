"""Programs compiled for one party: its reading, written down once as straight-line code and run from then on.

A plan is known before the first byte: which draw lies where on the tape, which number goes into which frame,
which bounds hold. So the party's text is read once on *slots* (:mod:`spdz.compiled.slots`) instead of
numbers, by a ring (:mod:`spdz.compiled.ring`) that writes down what it is asked for
(:mod:`spdz.compiled.trace`). What comes of it is Python source (:mod:`spdz.compiled.source`), run by
:mod:`spdz.compiled.straight`, in which

- few elements are Python integers from the tape to the frame, and sums are reduced mod p when they must be;
- what depends on the tape alone is done apart, before the inputs are known;
- nothing that is public is computed again: shapes, bounds, constants, lengths of frames.

The frames are those of the party's own reading (:mod:`spdz.readings.party`), byte by byte: either
side may run either. What cannot be compiled (a program that looks at numbers on its way, several vectors at
once) is read as before.
"""
