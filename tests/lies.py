"""What an insider may say instead of its share. An opened value is ``own + theirs``, and it has seen theirs.

A lie is ``lie(number, own, theirs)``, a list of numbers to send in DATA exchange ``number``. Ways to lie are
told for elements; in a bit they are what is left of them modulo 2.
"""

from insider_frames import reduced

from spdz.arithmetic.field import P

ELEMENT = {
    "plus 1": lambda own, theirs, e: own + 1,
    "opened as 0": lambda own, theirs, e: -theirs,
    "minus 1": lambda own, theirs, e: own - 1,
    "opened as 1": lambda own, theirs, e: 1 - theirs,
    "plus a random number": lambda own, theirs, e: own + e,
    "opened negated": lambda own, theirs, e: -own - 2 * theirs,
    "opened as a chosen number": lambda own, theirs, e: e - theirs,
    "opened doubled": lambda own, theirs, e: 2 * own + theirs,
    "another highest bit": lambda own, theirs, e: own + (1 << 126),
    "the honest share": lambda own, theirs, e: theirs,
    "no share": lambda own, theirs, e: 0,
}
"""One element: ``(own, theirs, e) -> said``."""

PAIR = {
    "shares swapped": lambda own, theirs, e: (own[1], own[0]),
    "openings swapped": lambda own, theirs, e: (
        own[1] + theirs[1] - theirs[0],
        own[0] + theirs[0] - theirs[1],
    ),
    "one share twice": lambda own, theirs, e: (own[0], own[0]),
    "cancelling": lambda own, theirs, e: (own[0] + e, own[1] - e),
    "cancelling where weighted 1 and 2": lambda own, theirs, e: (own[0] + 2 * e, own[1] - e),
}
"""Two elements of one opening: ``(both own, both theirs, e) -> both said``."""

FRAME = {
    "all plus a random number": lambda own, theirs, e: [one + e for one in own],
    "all opened as 0": lambda own, theirs, e: [-one for one in theirs],
    "all opened doubled": lambda own, theirs, e: [2 * a + b for a, b in zip(own, theirs, strict=True)],
    "the honest frame": lambda own, theirs, e: theirs,
    "in another order": lambda own, theirs, e: own[1:] + own[:1],
}
"""A whole opening: ``(own, theirs, e) -> said``."""


def element(number, i, say, e=1):
    """Lie in element i of one exchange."""

    def lie(at, own, theirs):
        if at != number:
            return own
        return [*own[:i], reduced(say(own[i], theirs[i], e), own[i]), *own[i + 1 :]]

    return lie


def pair(number, i, j, say, e=1):
    """Lie in elements i and j of one exchange."""

    def lie(at, own, theirs):
        said = list(own)
        if at == number:
            both = say((own[i], own[j]), (theirs[i], theirs[j]), e)
            said[i], said[j] = (reduced(one, own[k]) for one, k in zip(both, (i, j), strict=True))
        return said

    return lie


def frame(number, say, e=1):
    """Lie in a whole exchange."""

    def lie(at, own, theirs):
        if at != number:
            return own
        return [reduced(one, like) for one, like in zip(say(own, theirs, e), own, strict=True)]

    return lie


def cancelling(first, i, second, j, e=1):
    """Add e in one exchange and take it back in another."""
    add = element(first, i, ELEMENT["plus a random number"], e)
    undo = element(second, j, ELEMENT["plus a random number"], -e)
    return lambda at, own, theirs: undo(at, add(at, own, theirs), theirs)


def sampled(generator, openings):
    """Any lie of these kinds; ``openings`` are the sizes of the exchanges by number.

    Returns:
        The exchange in which it begins, the lie, and its description.
    """
    numbers = list(openings)
    number, e = generator.choice(numbers), generator.randrange(1, P)
    i, j = generator.randrange(openings[number]), generator.randrange(openings[number])
    kind = generator.choice(["element", "pair", "frame", "cancelling"])
    if kind == "element" or (kind == "pair" and i == j):
        how = generator.choice(list(ELEMENT))
        return number, element(number, i, ELEMENT[how], e), f"{how} in element {i} of exchange {number}"
    if kind == "pair":
        how = generator.choice(list(PAIR))
        return number, pair(number, i, j, PAIR[how], e), f"{how} in elements {i}, {j} of exchange {number}"
    if kind == "frame":
        how = generator.choice(list(FRAME))
        return number, frame(number, FRAME[how], e), f"{how} in exchange {number}"
    second = generator.choice(numbers)
    j = generator.randrange(openings[second])
    if (number, i) == (second, j):
        return number, element(number, i, ELEMENT["plus a random number"], e), f"element {i} of {number}"
    what = f"element {i} of exchange {number}, taken back in element {j} of exchange {second}"
    return min(number, second), cancelling(number, i, second, j, e), what
