"""A stand-in for an MP-SPDZ folder: it runs the generated programs on floats, in the clear.

The compiler stores a program under the name that MP-SPDZ gives it. The virtual machine executes the program's
own text with a tiny fixed-point type, so that a program that computes something else is seen.
"""

import sys

COMPILER = """\
import sys
from pathlib import Path

name, *arguments = sys.argv[1:]
text = Path("Programs/Source", name + ".mpc").read_text()
compile(text, name, "exec")
Path("Programs/Schedules").mkdir(exist_ok=True)
Path("Programs/Schedules", "-".join([name, *arguments]) + ".sch").write_text(text)
"""

MACHINE = """\
#!{python}
import argparse
import sys
import types
from decimal import Decimal
from pathlib import Path

import numpy as np

parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
for option in ("-p", "-N", "-h", "-pn", "-IF"):
    parser.add_argument(option, dest=option.strip("-"), required=True)
parser.add_argument("program")
options = parser.parse_args()
schedule = Path("Programs/Schedules", options.program + ".sch")
if (options.N, options.h) != ("2", "localhost") or not schedule.is_file():
    sys.exit("bad arguments: " + " ".join(sys.argv))
if options.p == "1":
    sys.exit(0)
inputs = [iter(Path(options.IF + "-P%d-0" % party).read_text().split()) for party in (0, 1)]


class sfix:
    precision = None

    def __init__(self, numbers):
        self.numbers = np.asarray(numbers)

    __abs__ = lambda self: sfix(np.abs(self.numbers))
    __sub__ = lambda self, other: sfix(self.numbers - other.numbers)
    __add__ = lambda self, other: sfix(self.numbers + other.numbers)
    __mul__ = lambda self, other: sfix(self.numbers * other.numbers)
    __truediv__ = lambda self, other: sfix(self.numbers / other.numbers)
    sum = lambda self: sfix(self.numbers.sum())

    def expand_to_vector(self, size):
        return sfix(np.full(size, float(self.numbers)))

    def reveal(self):
        return Decimal(round(float(self.numbers) * 65536)) / 65536

    @classmethod
    def set_precision(cls, f, k):
        cls.precision = f, k

    @staticmethod
    def get_input_from(party, size):
        assert sfix.precision == (16, 64)
        numbers = np.array([float(next(inputs[party])) for _ in range(size)])
        assert (numbers * 65536 == np.rint(numbers * 65536)).all()
        return sfix(numbers)

    @staticmethod
    def dot_product(x, y):
        return sfix(np.dot(x.numbers, y.numbers))


def for_range(count):
    return lambda body: [body(number) for number in range(count)]


math = types.SimpleNamespace(sqrt=lambda value: sfix(np.sqrt(value.numbers)))
sys.modules["Compiler"] = types.SimpleNamespace(mpc_math=math)
names = dict(
    sfix=sfix,
    cfix=types.SimpleNamespace(set_precision=lambda f, k: None),
    program=types.SimpleNamespace(args=options.program.split("-")),
    for_range=for_range,
    print_float_precision=lambda digits: None,
    print_ln=lambda text, *values: print(text % values),
)
print("Using statistical security parameter 40")
exec(schedule.read_text(), names)
print("Time = 0.01 seconds")
"""


def fake_mp_spdz(folder, *, machine=MACHINE, compiler=COMPILER, protocols=("mascot", "hemi")):
    """Make a folder that looks like a built MP-SPDZ."""
    folder.mkdir()
    (folder / "compile.py").write_text(compiler)
    for protocol in protocols:
        path = folder / f"{protocol}-party.x"
        path.write_text(machine.replace("{python}", sys.executable))
        path.chmod(0o755)
    return folder
