"""Keep large temporaries on the heap: for programs that are about nothing but this engine.

By default glibc maps fresh, zeroed pages for each array above 128 KB and gives them back at once, which
costs more than the arithmetic on them. It raises that limit, up to 32 MB, to the size of the largest mapped
block that has been freed. Commands call this once at their start; the library never does, since it changes
the whole process. Elsewhere than on glibc it does nothing of note.
"""

import numpy as np

_HEAP_BYTES = 16 << 20


def keep_large_arrays_on_the_heap() -> None:
    """Free one mapped block of 16 MB, untouched."""
    np.empty(_HEAP_BYTES, dtype=np.uint8)
