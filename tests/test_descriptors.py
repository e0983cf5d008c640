"""Descriptor files: whatever a file holds, it is read as NumPy would read it or refused in one line."""

import io
import os
import pickle
import subprocess
import sys
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from protocols.descriptors import load_descriptors

ROWS = np.arange(48, dtype=np.float64).reshape(3, 16) / 48


def saved(array, version=None):
    file = io.BytesIO()
    np.lib.format.write_array(file, array, version=version, allow_pickle=True)
    return file.getvalue()


def with_header(text, data=b"", version=1):
    """A file with this header, padded as NumPy pads it."""
    width = 2 if version == 1 else 4
    header = text.encode("latin-1")
    header += b" " * (-(len(header) + 9 + width) % 64) + b"\n"
    return b"\x93NUMPY" + bytes([version, 0]) + len(header).to_bytes(width, "little") + header + data


def header(descr="'<f8'", order="False", shape="(3, 16)"):
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


GOOD = saved(ROWS)
HEADER_BYTES = len(GOOD) - ROWS.nbytes

# A file, and what must be said of it.
REFUSED = {
    "nothing": (b"", "an empty file"),
    "one byte": (GOOD[:1], "not a .npy file"),
    "magic alone": (GOOD[:6], "damaged header"),
    "cut in the header's length": (GOOD[:9], "damaged header"),
    "no header": (GOOD[:10], "damaged header"),
    "cut in the header": (GOOD[:60], "damaged header"),
    "cut before the numbers": (GOOD[:HEADER_BYTES], f"expected the {len(GOOD)} bytes"),
    "cut in the numbers": (GOOD[:-9], f"got {len(GOOD) - 9}"),
    "two arrays": (GOOD + GOOD, "more was written to it than one array"),
    "text": (b"0.1 0.2\n", "not a .npy file"),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(100), "an HDF5 file"),
    "archive": (archive(a=ROWS, b=ROWS), "numpy.load(FILE)['NAME']"),
    "archive of one array": (archive(a=ROWS), "numpy.load(FILE)['NAME']"),
    "cut archive": (archive(a=ROWS)[:50], "an .npz or other archive"),
    "archive's magic": (b"PK\x03\x04", "an .npz or other archive"),
    "empty archive": (b"PK\x05\x06" + bytes(18), "an .npz or other archive"),
    "pickle": (pickle.dumps([1, 2]), "a pickle"),
    "objects": (saved(np.array([{}, 1], dtype=object)), "|O"),
    "records": (saved(np.zeros(3, [("a", "f4", 16)])), "('a','<f4'"),
    "complex numbers": (saved(ROWS * 1j), "<c16"),
    "booleans": (saved(ROWS > 0), "|b1"),
    "strings": (saved(np.array(["a"])), "<U1"),
    "dates": (saved(np.array(["2024-01-01"], dtype="M8[D]")), "<M8[D]"),
    "huge": (with_header(header(shape="(1000000000000, 16)")), "128000000000128 bytes"),
    "overflowing": (with_header(header(shape="(10000000000000000000000, 16)")), "damaged header"),
    "overflowing product": (with_header(header(shape="(10000000000, 10000000000)")), "bytes that its header"),
    "huge beside nothing": (
        with_header(header(shape="(0, " + "9" * 18 + ", " + "9" * 18 + ")")),
        "no array can",
    ),
    "negative": (with_header(header(shape="(-3, 16)")), "damaged header"),
    "not a tuple": (with_header(header(shape="(48)"), ROWS.tobytes()), "damaged header"),
    "list": (with_header("[1, 2]"), "damaged header"),
    "unclosed": (with_header(header()[:-3]), "damaged header"),
    "no such type": (with_header(header("'zz'")), "'zz'"),
    "floats of three bytes": (with_header(header("'<f3'")), "'<f3'"),
    "floats of no bytes": (with_header(header("'<f0'")), "'<f0'"),
    "escape sequences": (with_header(header(r"'\d\x1b[2J'")), "expected an array of integers or floats"),
    "terminal codes": (with_header(header("'\x1b[2J'")), r"\x1b"),
    "deep": (with_header(header("(" * 1500 + ")" * 1500)), "damaged header"),
    "deep list": (with_header(header("[" * 1500 + "]" * 1500)), "[[[["),
    "many axes": (with_header(header(shape="(" + "1," * 2000 + ")")), "damaged header"),
    "number of many digits": (with_header(header(shape="(" + "1" * 6000 + ",)")), "damaged header"),
    "almost matching": (with_header(header(shape="(" + "1," * 4000 + "x)")), "damaged header"),
    "space in a number": (with_header(header(shape="(3, 1 6)"), ROWS.tobytes()), "damaged header"),
    "leading zero": (with_header(header(shape="(3, 016)"), ROWS.tobytes()), "damaged header"),
    "null bytes": (with_header(header("'<f8'\0")), "damaged header"),
    "null header": (with_header("\0" * 50), "damaged header"),
    "twice the type": (with_header("{'descr': '<f8', 'descr': '<f8', 'shape': (3, 16)}"), "damaged header"),
    "another version": (b"\x93NUMPY\x09\x00" + GOOD[8:], "damaged header"),
    "long header": (with_header(header() + " " * 20_000, ROWS.tobytes(), 2), "damaged header"),
    "header of 4 GB": (b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + GOOD[10:], "damaged header"),
}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("descriptors") / "a.npy"


def refusal(path):
    with pytest.raises(ValueError, match="cannot read descriptors from") as caught:
        load_descriptors(path)
    assert len(str(caught.value).splitlines()) == 1 and str(caught.value).isprintable()
    return str(caught.value)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_array_of_numbers_is_refused_in_one_line(file, kind):
    data, says = REFUSED[kind]
    file.write_bytes(data)
    assert says in refusal(file)


def test_folders_missing_files_and_pipes_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "a folder" in refusal(tmp_path)
    assert "No such file" in refusal(tmp_path / "none.npy")
    assert "not a regular file" in refusal(tmp_path / "pipe")


@pytest.mark.parametrize("kind", ["huge", "overflowing product", "header of 4 GB", "cut in the numbers"])
def test_no_memory_is_taken_for_what_a_header_merely_claims(file, kind):
    file.write_bytes(REFUSED[kind][0])
    refusal(file)
    tracemalloc.start()
    try:
        refusal(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20


def test_numbers_beyond_this_machine_are_refused(file, monkeypatch):
    def exhausted(*_, **__):
        raise MemoryError

    file.write_bytes(GOOD)
    monkeypatch.setattr(np, "fromfile", exhausted)
    assert "memory" in refusal(file)


@given(
    array=npst.arrays(
        npst.integer_dtypes(endianness="?")
        | npst.unsigned_integer_dtypes(endianness="?")
        | npst.floating_dtypes(endianness="?"),
        npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
    ),
    version=st.sampled_from([(1, 0), (2, 0), (3, 0)]),
    fortran=st.booleans(),
)
def test_every_array_of_real_numbers_is_read_as_it_was_saved(file, array, version, fortran):
    file.write_bytes(saved(np.asarray(array, order="F") if fortran else array, version))
    loaded = load_descriptors(file)
    assert (loaded.dtype, loaded.shape) == (array.dtype, array.shape)
    assert loaded.tobytes() == array.tobytes()


@pytest.mark.parametrize(
    "text",
    [
        header(shape="(3L, 16L)"),
        "{'shape': (3, 16), 'descr': '<f8', 'fortran_order': False}",
        '{"descr": "<f8", "shape": (3,16), "fortran_order": False}',
    ],
    ids=["Python 2", "another order", "double quotes"],
)
def test_headers_of_other_writers_are_read(file, text):
    file.write_bytes(with_header(text, ROWS.tobytes()))
    np.testing.assert_array_equal(load_descriptors(file), ROWS)


def edits():
    """Changes of a file: bytes overwritten, left out or put in, most of them in the header."""
    position = st.integers(0, HEADER_BYTES + 20)
    piece = st.binary(max_size=6) | st.sampled_from(
        [b"L", b"(", b")", b"'", b",", b"0", b"9" * 9, b"True", b"\\d", b"-"]
    )
    return st.lists(st.tuples(position, st.integers(0, 6), piece), min_size=1, max_size=4)


@given(edits())
def test_a_damaged_file_is_refused_or_read_as_numpy_reads_it(file, changes):
    data = GOOD
    for position, dropped, piece in changes:
        data = data[:position] + piece + data[position + dropped :]
    file.write_bytes(data)
    try:
        loaded = load_descriptors(file)  # pytest makes errors of warnings
    except ValueError as error:
        assert str(error).startswith("cannot read descriptors from") and len(str(error).splitlines()) == 1
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = np.load(io.BytesIO(data))
    assert loaded.dtype == expected.dtype and loaded.shape == expected.shape
    assert loaded.tobytes() == expected.tobytes()


@pytest.mark.parametrize("kind", ["archive", "deep", "huge", "unclosed", "cut in the numbers"])
def test_the_command_says_it_in_one_line_with_status_2(file, kind):
    file.write_bytes(REFUSED[kind][0])
    words = (
        f"-m spdz match --tape none.tape --listen 127.0.0.1:1 --threshold 0.5 --descriptors {file}".split()
    )
    result = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2 and not result.stdout
    assert "cannot read descriptors" in result.stderr and len(result.stderr.splitlines()) == 1
