"""The ten scores as programs for MP-SPDZ, from their definitions.

A program takes two arguments, the length and the number of pairs. It reads all pairs in order from both
parties and prints one line a pair: :data:`MARK`, the pair's number, the opened score as a decimal.
"""

from __future__ import annotations

MARK = "SPDZ-SCORE"
"""The first word of a line of output."""

_FRAME = """\
# {name}: {what}
# Arguments: length of a vector, number of pairs.
from Compiler import mpc_math

sfix.set_precision({fraction_bits}, {bits})
cfix.set_precision({fraction_bits}, {bits})
print_float_precision(30)

length, pairs = int(program.args[1]), int(program.args[2])


def divide_all(vector, number):
    return vector / number.expand_to_vector(length)


def bar(vector):
    return divide_all(vector, abs(vector).sum())


def hat(vector):
    return divide_all(vector, mpc_math.sqrt(sfix.dot_product(vector, vector)))


def score(x, y):
{body}


@for_range(pairs)
def _(number):
    x = sfix.get_input_from(0, size=length)
    y = sfix.get_input_from(1, size=length)
    print_ln('{mark} %s %s', number, score(x, y).reveal())
"""

_HATS = "x, y = hat(x), hat(y)"
_SQUARE_OF_DIFFERENCE = "difference = x - y\nsquare = sfix.dot_product(difference, difference)"

BODIES: dict[str, tuple[str, str]] = {
    "S1": ("L1 distance of the L1-normalised vectors", "return abs(bar(x) - bar(y)).sum()"),
    "S2": ("L1 distance", "return abs(x - y).sum()"),
    "S3": (
        "L2 distance of the L2-normalised vectors",
        f"{_HATS}\n{_SQUARE_OF_DIFFERENCE}\nreturn mpc_math.sqrt(square)",
    ),
    "S4": ("L2 distance", f"{_SQUARE_OF_DIFFERENCE}\nreturn mpc_math.sqrt(square)"),
    "S5": (
        "squared L2 distance of the L2-normalised vectors",
        f"{_HATS}\n{_SQUARE_OF_DIFFERENCE}\nreturn square",
    ),
    "S6": ("squared L2 distance", f"{_SQUARE_OF_DIFFERENCE}\nreturn square"),
    "S7": ("dot product of the L2-normalised vectors", f"{_HATS}\nreturn sfix.dot_product(x, y)"),
    "S8": (
        "cosine with a root for either norm",
        "norm_x = mpc_math.sqrt(sfix.dot_product(x, x))\n"
        "norm_y = mpc_math.sqrt(sfix.dot_product(y, y))\n"
        "return sfix.dot_product(x, y) / (norm_x * norm_y)",
    ),
    "S9": (
        "cosine with one root",
        "squares = sfix.dot_product(x, x) * sfix.dot_product(y, y)\n"
        "return sfix.dot_product(x, y) / mpc_math.sqrt(squares)",
    ),
    "S10": ("dot product", "return sfix.dot_product(x, y)"),
}
"""What each score is, and the body of ``score(x, y)``."""


def program_text(name: str, *, fraction_bits: int = 16, bits: int = 64) -> str:
    """The text of a score's ``.mpc`` file.

    Args:
        name: ``"S1"`` to ``"S10"``.
        fraction_bits: Fractional bits of a fixed-point number.
        bits: All of its bits.
    """
    what, body = BODIES[name]
    return _FRAME.format(
        name=name,
        what=what,
        fraction_bits=fraction_bits,
        bits=bits,
        mark=MARK,
        body="\n".join("    " + line for line in body.splitlines()),
    )
