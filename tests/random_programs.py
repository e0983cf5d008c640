"""Random programs over the whole public interface, as text.

Program k of seed s is always the same text and the same inputs, whatever the engine does: drawing looks only
at exact numbers (:mod:`exact_reading`) and at its own estimate of how many bits a bound has.

To see one alone: ``python tests/random_programs.py SEED NUMBER``, or ``str(draw(SEED, NUMBER))``.
"""

import random
import sys
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, inf, log2, prod

import exact_reading
import numpy as np
from exact_reading import Number, fractions

import spdz
from protocols.cosine import cosine
from spdz.functions.power import power
from spdz.values.value import concatenate, split

LONGEST_COMPARED, LONGEST_OUTPUT = 83, 124
"""Bits of a bound up to which programs are drawn; the engine's own limits are a little further out."""

MOST_ENTRIES = 48
NAMES = (
    "absolute beaver_dot beaver_multiply divide dot l1_normalised l2_normalised largest mask maximum "
    "multiply nonnegative parallel reciprocal reciprocal_sqrt round_exactly sign sqrt truncate"
).split()


async def by_power(u, alpha):
    (result,) = await power(u, alpha=Fraction(alpha), signed=alpha == -1)
    (mantissa,) = await spdz.truncate(result.mantissa, frac=22)
    return multiply(mantissa, result.scale)


multiply = spdz.multiply
ENGINE = {name: getattr(spdz, name) for name in NAMES}
ENGINE |= {"by_power": by_power, "cosine": cosine, "concatenate": concatenate, "split": split, "np": np}
EXACT = {name: getattr(exact_reading, name) for name in ENGINE if name != "np"} | {"np": np}


def finish(coroutine):
    """Run a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration as done:
        return done.value
    raise AssertionError("an exact reading waits for nobody")


@dataclass
class Variable:
    """A name in a program: its exact numbers, whether it is masked, and bits of its bound in raw units."""

    name: str
    number: Number
    masked: bool
    bits: int

    @property
    def shape(self):
        return self.number.shape

    @property
    def frac(self):
        return self.number.frac


@dataclass
class RandomProgram:
    """A drawn program with its inputs; call it as any other program."""

    seed: int
    index: int
    security: str
    max_norm: float
    x: np.ndarray
    y: np.ndarray
    lines: list[tuple[str, tuple[str, ...]]] = field(default_factory=list)
    exact: dict[str, Number] = field(default_factory=dict)
    result: str = "x"
    probe: object = None

    def __str__(self):
        data = f"# seed {self.seed}, program {self.index}: {self.security}, max_norm = {self.max_norm!r}"
        inputs = "".join(f"\n{name} = {getattr(self, name).tolist()!r}" for name in "xy")
        body = "".join(f"\n    {line}" for line, _ in self.lines)
        return f"{data}{inputs}\nasync def program(engine, x, y):{body}\n    return {self.result}"

    def __hash__(self):
        return id(self)

    async def __call__(self, engine, x, y):
        function = compiled(self.lines, self.result)
        return await function(ENGINE, engine, x, y, self.probe or (lambda engine, name, value: None))


def compiled(lines, result):
    """The program as a function of its names, with a probe after each line."""
    source = "async def program(names, engine, x, y, probe):\n"
    source += "".join(f"    {name} = names[{name!r}]\n" for name in ENGINE)
    for line, targets in lines:
        source += f"    {line}\n" + "".join(f"    probe(engine, {name!r}, {name})\n" for name in targets)
    scope = {}
    exec(source + f"    return {result}\n", scope)
    return scope["program"]


# -- drawing --------------------------------------------------------------------------------------------

SHAPES = [(1,), (2,), (3,), (4,), (5,), (8,), (1, 3), (2, 3), (3, 1), (3, 3), (2, 1, 2), (1, 2, 2), (4, 4)]


def draw(seed, index):
    """Program ``index`` of this seed."""
    return _Drawing(seed, index).program


class _Drawing:
    def __init__(self, seed, index):
        self.random = random.Random(f"{seed} {index}")
        pick = self.random.choice
        security = pick(["malicious", "semi-honest"])
        max_norm = pick([2.0**-14, 2.0**-5, 0.75, 1.0, 1.0, 8.0, 100.0, 1000.0, 2.0**22])
        first = pick(SHAPES)
        second = pick([first, first, first, pick(SHAPES), first[-1:], (*first[:-1], 1)])
        x = self.vectors(first, max_norm)
        y = pick([1, -1]) * x if first == second and self.chance(0.4) else self.vectors(second, max_norm)
        self.program = RandomProgram(seed, index, security, max_norm, x, y)
        self.variables = []
        bits = ceil(log2(max_norm * 65536 + 4)) + 1
        for name, data in (("x", x), ("y", y)):
            self.variables.append(Variable(name, Number(fractions(data, 16), 0.0, 16), True, bits))
        self.program.exact = {one.name: one.number for one in self.variables}
        self.expensive = 0
        statements = self.random.randint(2, 9)
        for _ in range(200):
            if len(self.program.lines) >= statements:
                break
            self.statement()
        if self.chance(0.2):  # a comparison that is opened is dealt in another way than one that is used
            self.statement("compare")
        last = self.variables[-1] if self.chance(0.8) else pick(self.variables)
        self.program.result = last.name

    def chance(self, p):
        return self.random.random() < p

    def vectors(self, shape, max_norm):
        """Rows at the end of the range, mostly: only there does a bound that is too small show."""
        rows = np.zeros(shape)
        for place in np.ndindex(shape[:-1]):
            kind, n = self.random.choice("oooccccsrrt0"), shape[-1]
            row = np.zeros(n)
            if kind == "o":  # one coordinate
                row[self.random.randrange(n)] = self.random.choice([1, -1])
            elif kind == "c":  # all alike
                row[:] = self.random.choice([1, -1])
            elif kind == "s":  # alike but for the sign
                row[:] = [self.random.choice([1, -1]) for _ in range(n)]
            elif kind in "rt":
                row[:] = [self.random.gauss(0, 1) for _ in range(n)]
            length = np.linalg.norm(row)
            if length:
                row *= max_norm / length * (1 - 1e-12)
            if kind == "t":
                row *= 2.0 ** -self.random.randint(1, 12)
            rows[place] = row
        return rows

    # -- operands

    def some(self, test=lambda v: True):
        """A variable, rather a late one."""
        found = [v for v in self.variables if test(v)]
        if not found:
            raise LookupError
        return found[-1] if self.chance(0.5) else self.random.choice(found)

    def pair(self, test=lambda v: True):
        """Two that broadcast."""
        x = self.some(test)
        itself = self.chance(0.05)  # where masks cancel, a program is refused
        y = self.some(
            lambda v: test(v) and (v is not x or itself) and _broadcast(x.shape, v.shape) is not None
        )
        return (x, y) if self.chance(0.5) else (y, x)

    def masked(self, v):
        return v.name if v.masked else self.masked_anew(v)

    def masked_anew(self, v, fresh=""):
        name = self.fresh_name()
        self.add(f"({name},) = await mask({v.name}{fresh})", name, masked=True, bits=v.bits)
        return name

    def fresh_name(self):
        return f"v{len(self.variables)}"

    def add(self, line, *names, masked, bits):
        """Read a line in exact numbers and keep it; LookupError where it is not to be kept."""
        masked = masked if isinstance(masked, tuple) else (masked,) * len(names)
        bits = bits if isinstance(bits, tuple) else (bits,) * len(names)
        if max(bits) > LONGEST_OUTPUT:
            raise LookupError
        known = {v.name: v.number for v in self.variables}
        source = "async def line(names):\n"
        source += "".join(f"    {name} = names[{name!r}]\n" for name in [*EXACT, *known])
        scope = {}
        exec(f"{source}    {line}\n    return ({', '.join(names)},)", scope)
        numbers = finish(scope["line"](EXACT | known))
        if any(prod(z.shape) > MOST_ENTRIES for z in numbers):
            raise LookupError
        for name, number, is_masked, length in zip(names, numbers, masked, bits, strict=True):
            self.variables.append(Variable(name, number, is_masked, length))
            self.program.exact[name] = number
        self.program.lines.append((line, names))

    def one(self, line, *, masked, bits):
        name = self.fresh_name()
        self.add(f"{name} = {line}", name, masked=masked, bits=bits)

    def statement(self, kind=None):
        kinds = [kind for kind, weight in KINDS.items() for _ in range(weight)]
        state = len(self.variables), len(self.program.lines)
        try:
            getattr(self, kind or self.random.choice(kinds))()
        except LookupError:
            del self.variables[state[0] :], self.program.lines[state[1] :]
            self.program.exact = {v.name: v.number for v in self.variables}

    # -- public numbers

    def public(self, shape, *, whole=None, largest=9, unit=16):
        """Text of a public number that broadcasts with a shape, and the bits of its magnitude."""
        pick, whole = self.random.choice, self.chance(0.5) if whole is None else whole

        def number():
            if whole:
                return pick(
                    [0, 1, -1, 2, -2, 3, -3, largest, -largest, self.random.randint(-largest, largest)]
                )
            return pick([-1, 1]) * self.random.randint(0, largest << min(unit, 16)) / (1 << unit)

        def bits(values):
            return max(1, ceil(log2(max(abs(float(one)) for one in values) + 1)))

        if self.chance(0.5):
            value = number() or pick([1, -1, 0])
            forms = ["np.int64({})", "np.array({})"] if whole else ["np.float64({})", "np.array({})"]
            if not whole and abs(value) < 60000 and unit <= 5:
                forms += ["np.float16({})", "np.float32({})", "np.longdouble({})"]
            return (pick(forms).format(value) if self.chance(0.3) else repr(value)), bits([value])
        options = [
            shape,
            shape[-1:],
            (*shape[:-1], 1),
            (1, *shape),
            (2, *shape) if prod(shape) < 12 else shape,
            (*shape[:-1], 4) if shape[-1:] in ((), (1,)) else shape,
        ]
        wanted = pick([one for one in options if one != ()] or [(1,), (2,)])
        values = [number() for _ in range(prod(wanted))]
        if self.chance(0.7):
            values = [value or 1 for value in values]
        text = repr(np.array(values, dtype=object).reshape(wanted).tolist())
        kinds = ["", ", dtype=np.int32", ", dtype=np.int8"] if whole else [""]
        if whole and min(values) >= 0:
            kinds += [", dtype=np.uint64", ", dtype=np.uint8"]
        if whole and set(values) <= {0, 1}:
            kinds.append(", dtype=bool")
        if not whole and unit <= 5:
            kinds += [", dtype=np.float16", ", dtype=np.float32", ", dtype=np.longdouble"]
        if whole and largest > 100:
            kinds = ["", ", dtype=object"]
        return f"np.array({text}{pick(kinds)})", bits(values)

    # -- statements: linear maps

    def plus(self):
        x, y = self.pair()
        masked = x.masked and y.masked
        sign = self.random.choice("+-")
        self.one(f"{x.name} {sign} {y.name}", masked=masked, bits=_sum_bits(x, y))

    def plus_public(self):
        x = self.some()
        frac = 16 if x.frac is None else x.frac
        whole = self.chance(0.5)
        unit = min(5 if self.chance(0.4) else 16, max(frac, 16))
        text, length = self.public(x.shape, whole=whole, largest=self.random.choice([9, 9, 3000]), unit=unit)
        form = self.random.choice(["{v} + {n}", "{v} - {n}", "{n} - {v}", "{n} + {v}"])
        lift = 0 if whole or x.frac is None else max(16 - x.frac, 0)
        frac = (x.bits if x.frac is None else x.frac) + lift
        self.one(form.format(v=x.name, n=text), masked=x.masked, bits=max(x.bits + lift, length + frac) + 1)

    def plus_raw(self):
        x = self.some(lambda v: v.frac is not None)
        if self.chance(0.2):
            text, length = self.random.choice(
                [("np.array([-(2**63)])", 64), ("2**64 - 1", 64), ("-(2**63)", 64)]
            )
        else:
            text, length = self.public(x.shape, whole=True, largest=self.random.choice([1, 70000]))
        self.one(f"{x.name}.plus_raw({text})", masked=x.masked, bits=max(x.bits, length) + 1)

    def times_public(self):
        x = self.some()
        whole = self.chance(0.5)
        largest = self.random.choice([1, 9, 9, 1000] + [1 << 40] * (x.bits < 50 and whole))
        text, length = self.public(x.shape, whole=whole, largest=largest, unit=5 if self.chance(0.5) else 16)
        form = self.random.choice(["{v} * {n}", "{n} * {v}"])
        self.one(form.format(v=x.name, n=text), masked=x.masked, bits=x.bits + length + (0 if whole else 16))

    def negate(self):
        x = self.some()
        self.one(f"-{x.name}", masked=x.masked, bits=x.bits)

    def total(self):
        x = self.some(lambda v: v.shape)
        axis = self.random.randrange(-len(x.shape), len(x.shape))
        text = f"{x.name}.sum()" if axis == -1 and self.chance(0.5) else f"{x.name}.sum({axis})"
        self.one(text, masked=x.masked, bits=x.bits + ceil(log2(x.shape[axis] + 1)))

    def reshape(self):
        x = self.some()
        size = prod(x.shape)
        shapes = [(size,), (1, size), (size, 1), (1, *x.shape), (*x.shape, 1)]
        shapes += [(a, size // a) for a in (2, 3, 4) if size % a == 0]
        shapes += [x.shape[::-1]] + [()] * (size == 1)
        shape = self.random.choice(shapes)
        text = "-1" if len(shape) == 1 and self.chance(0.5) else ", ".join(map(str, shape))
        self.one(f"{x.name}.reshape({text})", masked=x.masked, bits=x.bits)

    def index(self):
        x = self.some(lambda v: v.shape)
        keys, ellipsis = [], False
        for length in x.shape:
            if self.chance(0.15):
                keys.append("None")
            if not ellipsis and self.chance(0.2):
                keys.append("...")
                ellipsis = True
                break
            if self.chance(0.3):
                keys.append(str(self.random.randrange(-length, length)))
            else:
                start, stop = sorted(self.random.sample(range(length + 1), 2))
                keys.append(self.random.choice([":", "::2", "::-1", f"{start}:{stop}", f"{stop - 1}:"]))
            if self.chance(0.3):
                break
        if ellipsis and self.chance(0.5):
            keys.append(
                self.random.choice([":1", "None", "::-1", "0"]) if len(keys) <= len(x.shape) else "None"
            )
        text = ", ".join(keys) or "..."
        self.one(f"{x.name}[{text}]", masked=x.masked, bits=x.bits)

    def join(self):
        x = self.some(lambda v: v.shape)
        y = self.some(lambda v: v.shape and v.shape[1:] == x.shape[1:])
        name, masked = self.fresh_name(), x.masked and y.masked
        self.add(f"{name} = concatenate({x.name}, {y.name})", name, masked=masked, bits=_sum_bits(x, y))
        if self.chance(0.3):
            count = len(self.variables)
            names = f"v{count}", f"v{count + 1}"
            shapes = (x.shape, y.shape) if self.chance(0.5) else (y.shape, x.shape)
            self.add(
                f"{', '.join(names)} = split({name}, [{shapes[0]}, {shapes[1]}])",
                *names,
                masked=masked,
                bits=_sum_bits(x, y),
            )

    def rescale(self):
        x = self.some(lambda v: v.frac is not None)
        more = self.random.choice([0, 1, 3, 16])
        self.one(f"{x.name}.rescaled({x.frac + more})", masked=x.masked, bits=x.bits + more)

    # -- statements: gates

    def remask(self):
        x = self.some()
        self.masked_anew(x, self.random.choice(["", ", fresh=True"]))

    def products(self):
        count = self.random.choice([2, 2, 2, 3])
        factors = [*self.pair()]
        if count == 3:
            shape = _broadcast(factors[0].shape, factors[1].shape)
            factors.append(self.some(lambda v: _broadcast(shape, v.shape) is not None))
        bits, limits = sum(v.bits for v in factors), ""
        self.require(bits, LONGEST_OUTPUT)
        names = [self.masked(v) for v in factors]
        if self.chance(0.3):
            product = exact_reading.multiply(*(v.number for v in factors))
            entry = product.size
            rows = np.atleast_1d(exact_reading.magnitudes(product) + product.error)
            norm = float(np.linalg.norm(rows, axis=-1).max()) * exact_reading.UP
            self.require(norm, 1e30)
            limits = self.random.choice(
                [f", entry={entry!r}", f", norm={norm!r}", f", entry={entry!r}, norm={norm!r}"]
            )
            if all(v.frac is not None for v in factors):
                frac = sum(v.frac for v in factors)
                bits = min(
                    bits, max(ceil(log2((entry if "entry" in limits else norm) * 2.0**frac + 1)) + 1, 1)
                )
        self.one(f"multiply({', '.join(names)}{limits})", masked=False, bits=bits)

    def dots(self):
        x = self.some(lambda v: v.shape)
        y = self.some(
            lambda v: v.shape[-1:] == x.shape[-1:] and _broadcast(x.shape[:-1], v.shape[:-1]) is not None
        )
        bits = x.bits + y.bits + ceil(log2(x.shape[-1] + 1))
        self.require(bits, LONGEST_OUTPUT)
        self.one(f"dot({self.masked(x)}, {self.masked(y)})", masked=False, bits=bits)

    def beaver(self):
        x = self.some()
        y = self.some(lambda v: v.shape == x.shape)
        if x.shape and self.chance(0.5):
            bits = x.bits + y.bits + ceil(log2(x.shape[-1] + 1))
            self.one(f"await beaver_dot({x.name}, {y.name})", masked=False, bits=bits)
        else:
            self.one(f"await beaver_multiply({x.name}, {y.name})", masked=False, bits=x.bits + y.bits)

    def compare(self):
        x = self.some(lambda v: v.bits <= LONGEST_COMPARED)
        call = f"nonnegative({x.name})"
        if x.frac is not None and x.number.size < inf and self.chance(0.3):
            bound = int(x.number.size * 2.0**x.frac) + 2
            call = f"nonnegative({x.name}, {bound})"
        elif self.chance(0.3):
            call = f"sign({x.name})"
        self.one(f"await {call}", masked=False, bits=1)

    def magnitude(self):
        x = self.some(lambda v: v.bits <= LONGEST_COMPARED)
        self.one(f"await absolute({x.name})", masked=False, bits=x.bits)

    def larger(self):
        if self.chance(0.3):
            return self.larger_than_public()
        x, y = self.pair(lambda v: v.bits < LONGEST_COMPARED)
        self.require(_sum_bits(x, y), LONGEST_COMPARED)
        self.one(f"await maximum({x.name}, {y.name})", masked=False, bits=_sum_bits(x, y))

    def larger_than_public(self):
        x = self.some(lambda v: v.bits < LONGEST_COMPARED)
        frac = 16 if x.frac is None else x.frac
        whole = self.chance(0.5)
        unit = min(5 if self.chance(0.4) else 16, max(frac, 16))
        text, length = self.public(x.shape, whole=whole, largest=self.random.choice([9, 9, 3000]), unit=unit)
        lift = 0 if whole or x.frac is None else max(16 - x.frac, 0)
        bits = max(x.bits + lift, length + (x.bits if x.frac is None else x.frac) + lift) + 1
        self.require(bits, LONGEST_COMPARED)
        form = self.random.choice(["await maximum({v}, {n})", "await maximum({n}, {v})"])
        form = "-await maximum(-{v}, 0)" if self.chance(0.1) else form
        self.one(form.format(v=x.name, n=text), masked=False, bits=bits)

    def largest(self):
        x = self.some(lambda v: v.shape and v.bits < LONGEST_COMPARED)
        self.one(f"await largest({x.name})", masked=False, bits=x.bits)

    def cut(self):
        count = self.random.choice([1, 1, 2])
        test = lambda v: v.bits <= LONGEST_COMPARED and (v.frac is None or v.frac > 0)  # noqa: E731
        values = [self.some(test) for _ in range(count)]
        highest = min(22 if v.frac is None else v.frac for v in values)
        frac = self.random.choice([0, highest // 2, max(highest - 1, 0), highest, min(highest, 16)])
        gate = self.random.choice(["truncate", "truncate", "round_exactly"])
        names = [f"v{len(self.variables) + i}" for i in range(count)]
        operands = ", ".join(v.name for v in values)
        bits = tuple(max(v.bits - (0 if v.frac is None else v.frac - frac), 1) + 1 for v in values)
        masked = tuple(gate == "truncate" or v.frac == frac for v in values)
        left = ", ".join(names) + ("," if count == 1 else "")
        self.add(
            f"{left} = await {gate}({operands}, frac={frac})".replace(f"{names[0]}, =", f"({names[0]},) ="),
            *names,
            masked=masked,
            bits=bits,
        )

    def in_parallel(self):
        x, y = (self.some(lambda v: v.bits <= LONGEST_COMPARED) for _ in range(2))
        count = len(self.variables)
        names = f"v{count}", f"v{count + 1}"
        calls = [self.random.choice(["nonnegative", "sign", "absolute"]) for _ in range(2)]
        self.add(
            f"{names[0]}, {names[1]} = await parallel({calls[0]}({x.name}), {calls[1]}({y.name}))",
            *names,
            masked=False,
            bits=(max(x.bits, 1), max(y.bits, 1)),
        )

    # -- statements: functions

    def costly(self, most=2):
        self.expensive += 1
        self.require(self.expensive, most)

    def require(self, number, most):
        if not number <= most:
            raise LookupError

    def roots(self):
        self.costly()
        x = self.some(lambda v: v.bits <= 78 and prod(v.shape) <= 12)
        call = self.random.choice(
            [
                "sqrt({})",
                "sqrt({})",
                "reciprocal_sqrt({})",
                "reciprocal({})",
                "reciprocal({}, positive=True)",
                "by_power({}, 0.5)",
                "by_power({}, -0.5)",
                "by_power({}, -1)",
            ]
        )
        bits = x.bits + 60
        self.one(f"await {call.format(x.name)}", masked=False, bits=min(bits, LONGEST_OUTPUT))

    def quotient(self):
        self.costly()
        x, y = self.pair(lambda v: v.bits <= 60 and prod(v.shape) <= 12)
        positive = self.chance(0.3)
        limit = exact_reading.divide(x.number, y.number, largest=1, frac=60, positive=positive)
        size = finish(limit).size
        self.require(size, 2.0**24)
        frac = self.random.choice([0, 8, 24, 30])
        limit = max(size, 2.0**-30) * self.random.choice([1, 1, 3])
        text = (
            f"await divide({x.name}, {y.name}, largest={limit!r}, frac={frac}{', positive=True' * positive})"
        )
        self.one(text, masked=True, bits=max(ceil(log2(limit * 2.0**frac + 1)), 1) + 2)

    def cosines(self):
        self.costly()
        x = self.some(lambda v: v.shape and v.bits <= 38 and prod(v.shape[:-1]) <= 4)
        y = self.some(
            lambda v: (
                v.shape[-1:] == x.shape[-1:] and v.bits <= 38 and _broadcast(x.shape, v.shape) is not None
            )
        )
        self.require(prod(_broadcast(x.shape, y.shape)[:-1]), 6)
        self.one(f"await cosine({self.masked(x)}, {self.masked(y)})", masked=False, bits=70)

    def normalised(self):
        self.costly()
        l1 = self.chance(0.4)
        most = 60 if l1 else 38
        x = self.some(lambda v: v.shape and v.bits <= most and prod(v.shape[:-1]) <= 6)
        name = self.masked(x)
        result = self.fresh_name()
        self.add(
            f"({result},) = await {'l1' if l1 else 'l2'}_normalised({name})", result, masked=True, bits=26
        )


KINDS = {
    "plus": 7, "plus_public": 5, "plus_raw": 2, "times_public": 7, "negate": 1, "total": 4, "reshape": 3,
    "index": 4, "join": 3, "rescale": 2, "remask": 1, "products": 7, "dots": 5, "beaver": 2, "compare": 4,
    "magnitude": 3, "larger": 5, "largest": 2, "cut": 6, "in_parallel": 1, "roots": 2, "quotient": 1,
    "normalised": 1, "cosines": 1,
}  # fmt: skip
"""Statements and how often each is tried."""


def _broadcast(a, b):
    try:
        return np.broadcast_shapes(a, b)
    except ValueError:
        return None


def _sum_bits(x, y):
    if x.frac is None or y.frac is None:
        return max(x.bits, y.bits) + 60
    frac = max(x.frac, y.frac)
    return max(v.bits + frac - v.frac for v in (x, y)) + 1


if __name__ == "__main__":
    print(draw(int(sys.argv[1]), int(sys.argv[2])))
