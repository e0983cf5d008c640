"""Descriptors from a ``.npy`` file that may be damaged, cut off, or another kind of file altogether.

The format is NumPy's (NEP 1, ``numpy.lib.format``): magic, version, header, numbers. The header is a Python
literal, and NumPy evaluates it: a damaged one then warns, recurses without end, or asks for more memory than
there is, each with an error of its own. Here it is matched against the form that it has for real numbers,
nothing of it is evaluated, and memory is taken only once the file is found to be as long as its header says.
"""

from __future__ import annotations

import math
import re
import stat
import struct
from itertools import permutations
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

_MAGIC = b"\x93NUMPY"
_LENGTHS = {b"\1\0": "<H", b"\2\0": "<I", b"\3\0": "<I"}
"""How the length of the header is written, by version."""

_LONGEST_HEADER = 10_000
"""As in NumPy; that of an array of numbers has about 120 bytes."""

_AXIS = r"(?:0|[1-9]\d{0,17})L?"  # Python 2 wrote 3L for 3
_ENTRIES = (
    r"'descr':(?P<descr>'[^']*'|\[.*\])",
    r"'fortran_order':(?P<order>True|False)",
    rf"'shape':\((?P<shape>(?:(?:{_AXIS},){{1,32}}(?:{_AXIS})?)?)\)",
)
_HEADERS = [re.compile(rf"{{{','.join(order)},?}}", re.ASCII) for order in permutations(_ENTRIES)]
"""The header without white space around its punctuation; its entries may come in any order."""

_REAL = re.compile(r"'[<>=|]?[iuf]\d{1,2}'", re.ASCII)

_FOREIGN = {
    b"PK": "an .npz or other archive; take one array out: numpy.save('a.npy', numpy.load(FILE)['NAME'])",
    b"\x89HDF": "an HDF5 file; take one array out: numpy.save('a.npy', h5py.File(FILE)['NAME'][:])",
    b"\x80": "a pickle, which is never opened here; save the array in it with numpy.save",
}
"""What begins so is not ``.npy`` but something that people keep descriptors in."""


def load_descriptors(path: Path) -> npt.NDArray[Any]:
    """Read one array of real numbers from a ``.npy`` file.

    An ``.npz`` is refused, also one of a single array: which array is meant should be said once, by the user.

    Args:
        path: The file.

    Returns:
        The array as it was saved: integers or floats of any size and byte order, of any shape.

    Raises:
        ValueError: the file cannot be read or holds no such array. The message is one line.
    """
    try:
        return _read(path)
    except MemoryError:
        reason = "its numbers do not fit this machine's memory; compare them in several files"
    except OSError as error:
        reason = error.strerror or str(error)
    except ValueError as error:
        reason = str(error)
    raise ValueError(f"cannot read descriptors from {path}: {reason}")


def _read(path: Path) -> npt.NDArray[Any]:
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):  # opening a pipe would wait for a writer
        raise ValueError("a folder, not a file" if stat.S_ISDIR(about.st_mode) else "not a regular file")
    with path.open("rb") as file:
        header, offset = _header(file)
        if not _REAL.fullmatch(header["descr"]):
            raise _not_real(header["descr"])
        try:
            dtype = np.dtype(header["descr"][1:-1])
        except TypeError:  # floats of 3 bytes
            raise _not_real(header["descr"]) from None
        shape = tuple(int(axis.rstrip("L")) for axis in header["shape"].split(",") if axis)
        count = math.prod(shape)
        promised = offset + count * dtype.itemsize
        if about.st_size != promised:
            raise ValueError(
                f"expected the {promised} bytes that its header promises, got {about.st_size}: it was cut "
                "off, or more was written to it than one array; write it again with numpy.save"
            )
        file.seek(offset)
        numbers = np.fromfile(file, dtype=dtype, count=count)
    try:
        return numbers.reshape(shape, order="F" if header["order"] == "True" else "C")
    except ValueError:  # huge axes beside one of length 0
        raise ValueError("no array can have the shape in its header; write it with numpy.save") from None


def _header(file: BinaryIO) -> tuple[dict[str, str], int]:
    """The three entries of the header, as they are written, and where the numbers begin."""
    start = file.read(len(_MAGIC) + 2)
    for magic, what in _FOREIGN.items():
        if start.startswith(magic):
            raise ValueError(what)
    if not start.startswith(_MAGIC):
        what = "not a .npy file" if start else "an empty file"
        raise ValueError(f"{what}; write the array with numpy.save")
    damaged = ValueError("a .npy file with a damaged header; write it again with numpy.save")
    length_format = _LENGTHS.get(start[len(_MAGIC) :], "")
    written = file.read(struct.calcsize(length_format))
    if not written or len(written) < struct.calcsize(length_format):
        raise damaged
    (length,) = struct.unpack(length_format, written)
    text = file.read(min(length, _LONGEST_HEADER)).decode("latin-1")
    spaced = re.sub(r"[ \t\r\n]+", " ", text).strip(" ").replace('"', "'")
    plain = re.sub(r" ?([][(){}:,]) ?", r"\1", spaced)
    found = next(filter(None, (header.fullmatch(plain) for header in _HEADERS)), None)
    if found is None or len(text) != length:
        raise damaged
    return found.groupdict(), file.tell()


def _not_real(descr: str) -> ValueError:
    return ValueError(
        f"expected an array of integers or floats, got one of type {descr[:24]!a}; convert it to float64 and "
        "write it with numpy.save"
    )
