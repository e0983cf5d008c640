"""A gallery that is looked at by ``python -m spdz tape``."""

import json

from stream_helpers import tape

from spdz.__main__ import main
from spdz.gallery import GalleryTape
from spdz.gallery.ledger import Ledger
from spdz.gallery.strip import Strip


def show(capsys, mission, *words, party=0):
    """Status, standard output and standard error."""
    state = ("--state-dir", str(mission / f"state-{party}"))
    status = main(["tape", str(tape(mission, party)), *state, *map(str, words)])
    return status, *capsys.readouterr()


def facts(capsys, mission, *words, **options):
    status, out, err = show(capsys, mission, "--json", *words, **options)
    assert (status, err) == (0, "")
    return json.loads(out)


def opened(mission, party=0):
    return GalleryTape.open(tape(mission, party), state_dir=mission / f"state-{party}")


def ledger(mission, party=0):
    with opened(mission, party) as one:
        name = one.header.tape
    path = tape(mission, party).with_suffix(".ledger")
    return Ledger.open(path, name, party, state_dir=mission / f"state-{party}")


def begun(mission):
    """A ledger with 3 x 2 slots, one of them void, 2 x 2 pairs done, half of them burnt, one in flight."""
    with ledger(mission) as one:
        one.slots[0].fill([(0, b"a"), (1, None), (2, b"c")])
        one.slots[1].fill([(0, b"d"), (1, b"e")])
        one.pin_text(b"text S10 >= 0.2, to 2^-16")
        for strip in (Strip(range(1), range(2)), Strip(range(1, 2), range(2))):
            one.begin(strip)
            one.burn(strip) if strip.rows.start else one.commit(strip, b"\0")
        one.begin(Strip(range(2, 3), range(2)))
