"""The frames of one exchange as numbers: field elements, words of inputs, and bits."""

from dataclasses import dataclass

from spdz.arithmetic.field import P

ELEMENT = 16


class Bit(int):
    """A share of an opened bit: 0 or 1."""


def reduced(number, like):
    """What is said instead of ``like``: an element or word below p, or a bit."""
    return Bit(number % 2) if isinstance(like, Bit) else number % P


def elements(frame, size=ELEMENT):
    """The numbers of a frame: field elements, or the shorter words of inputs under short masks."""
    return [int.from_bytes(frame[start : start + size], "little") for start in range(0, len(frame), size)]


def frame_of(numbers, size=ELEMENT):
    return b"".join(number.to_bytes(size, "little") for number in numbers)


def unpacked(frame, bits):
    return [Bit(frame[i // 8] >> i % 8 & 1) for i in range(bits)]


def packed(bits):
    return sum(bit << i for i, bit in enumerate(bits)).to_bytes(-(-len(bits) // 8), "little")


@dataclass
class Layout:
    """Where the numbers of one exchange lie in either party's frame.

    Attributes:
        pieces: For each buffer its bytes, and the numbers in it.
        size: Bytes of a number that is no bit.
        bits: Which buffers are bits.
    """

    pieces: list[tuple[int, int]]
    size: int
    bits: list[bool]

    @classmethod
    def of(cls, request, bits, *, inputs):
        """Of the request of one party; arrays of bits have ``bits`` entries, fewer than fill 16 bytes."""
        lengths = [len(buffer) for buffer in request.payload]
        if inputs:
            size = sum(lengths) // request.elements
            return cls([(length, length // size) for length in lengths], size, [False] * len(lengths))
        are_bits = [length % ELEMENT > 0 for length in lengths]
        assert all(length == -(-bits // 8) for length, are in zip(lengths, are_bits, strict=True) if are)
        counts = [bits if are else length // ELEMENT for length, are in zip(lengths, are_bits, strict=True)]
        return cls(list(zip(lengths, counts, strict=True)), ELEMENT, are_bits)

    @property
    def count(self):
        return sum(count for _, count in self.pieces)

    @property
    def all_bits(self):
        return all(self.bits)

    def numbers(self, frame):
        found, start = [], 0
        for (length, count), are_bits in zip(self.pieces, self.bits, strict=True):
            piece = frame[start : start + length]
            found += unpacked(piece, count) if are_bits else elements(piece, self.size)
            start += length
        return found

    def frame(self, numbers):
        """The frame of numbers that lie like this; if they are more or fewer, all in one piece."""
        if len(numbers) != self.count:
            return packed(numbers) if self.all_bits else frame_of(numbers, self.size)
        frame, start = b"", 0
        for (_, count), are_bits in zip(self.pieces, self.bits, strict=True):
            piece = numbers[start : start + count]
            frame += packed(piece) if are_bits else frame_of(piece, self.size)
            start += count
        return frame
