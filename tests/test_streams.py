"""Standard streams that are closed, full, or read by somebody who leaves: no command is harmed by them."""

import io
import json
import os
import subprocess
import sys

import pytest

from spdz.console.command import INTERRUPTED, run_command
from spdz.console.streams import GuardedStream

PLAN = "spdz.dealer --agents a b --score S10 --dim 8 --count 3 --plan"
PYTHON = f'"{sys.executable}" -m'
FULL = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")


def shell(line):
    """Run a line of bash, with buffered streams; standard error ends with the first command's status."""
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    result = subprocess.run(
        ["bash", "-c", f"{line}; echo STATUS ${{PIPESTATUS[0]}} >&2"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=buffered,
    )
    told, _, status = result.stderr.rpartition("STATUS ")
    return int(status), result.stdout, told


@pytest.mark.parametrize("command", [PLAN, f"{PLAN} --json", "spdz --help", "spdz.dealer --help"])
@pytest.mark.parametrize("where", ["| true", "| head -1", ">&-", "<&-", ">&- <&-", "2>&- >&-"])
def test_closed_streams_and_readers_that_leave_are_quiet_and_no_failure(command, where):
    status, out, told = shell(f"{PYTHON} {command} {where}")
    assert (status, told) == (0, "")
    assert bool(out) == (where in ("| head -1", "<&-"))


@FULL
@pytest.mark.parametrize("command", [PLAN, "spdz.dealer --help", "spdz --version"])
def test_a_full_disk_is_one_line_and_status_1(command):
    status, _, told = shell(f"{PYTHON} {command} > /dev/full")
    assert status == 1 and "No space left" in told and len(told.splitlines()) == 1


@FULL
def test_a_full_standard_error_changes_nothing():
    status, out, _ = shell(f"{PYTHON} {PLAN} 2> /dev/full")
    assert status == 0 and "plan" in out


@FULL
def test_what_went_well_is_not_undone_when_it_cannot_be_told(tmp_path):
    words = f"spdz.dealer --agents a b --score S10 --dim 8 --count 3 --out {tmp_path}/m"
    assert shell(f"{PYTHON} {words} > /dev/full")[0] == 1
    assert (tmp_path / "m" / "a" / "b.tape").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("spdz --json", "COMMAND"),
        ("spdz nonsense --json", "invalid choice"),
        ("spdz tape --json", "FILE"),
        ("spdz match --json --wait soon", "invalid float"),
        ("spdz match --tape a --listen b --descriptors c --js --nonsense", "unrecognized"),
        ("spdz.dealer --json", "--agents"),
        ("spdz.dealer --agents a b --score S10 --dim 3 --count 1 --json", "--out"),
        ("bench --json --score S11", "invalid choice"),
        ("bench accuracy --json --trials 0", "must be positive"),
        ("bench oracle --json", "--mp-spdz"),
    ],
)
def test_usage_errors_are_json_where_json_is_asked_for(words, says):
    status, out, told = shell(f"{PYTHON} {words}")
    fields = json.loads(out)
    assert (status, fields["error"]) == (2, "UsageError") and says in fields["message"]
    assert "usage:" in told
    plain = words.replace("--json", "").replace("--js", "")
    assert shell(f"{PYTHON} {plain}")[1] == ""


def test_closed_descriptors_are_not_given_to_the_next_file():
    source = (
        "import sys; from spdz.console.command import run_command\n"
        "def main():\n"
        "    with open(sys.argv[1], 'w') as file:\n"
        "        return 0 if file.fileno() > 2 else 9\n"
        "sys.exit(run_command('test', main))"
    )
    assert shell(f"'{sys.executable}' -c \"{source}\" /dev/null <&- >&- 2>&-")[0] == 0


class Failing(io.StringIO):
    """A stream that is broken from its second write on."""

    encoding = "ascii"

    def __init__(self, error):
        super().__init__()
        self.failure, self.writes = error, 0

    def write(self, text):
        self.writes += 1
        if self.writes > 1:
            raise self.failure
        return super().write(text)


def test_the_first_failure_is_kept_and_nothing_is_written_after_it():
    stream = Failing(OSError(28, "No space left on device"))
    guarded = GuardedStream(stream)
    for text in ("one", "two", "three"):
        assert guarded.write(text) == len(text)
    guarded.settle()
    assert stream.getvalue() == "one" and stream.writes == 2 and guarded.error.errno == 28


def test_what_the_encoding_cannot_say_is_escaped():
    stream = Failing(OSError())
    assert GuardedStream(stream).write("caf\u00e9 \udcff") == 6
    assert stream.getvalue() == "caf\\xe9 \\udcff"


@pytest.mark.parametrize("status", [0, 1, 2, 130])
def test_a_status_of_its_own_survives_a_full_disk(status, monkeypatch, capsys):
    stream = Failing(OSError(28, "No space left on device"))
    stream.writes = 1
    monkeypatch.setattr(sys, "stdout", stream)
    assert run_command("test", lambda: print("text") or status) == (status or 1)
    assert capsys.readouterr().err == "test: cannot write to standard output: No space left on device\n"
    assert sys.stdout is stream


def raising(error):
    def main():
        raise error

    return main


@pytest.mark.parametrize("as_json", [False, True])
def test_memory_that_runs_out_is_one_line_and_status_1(capsys, as_json):
    error = MemoryError("Unable to allocate 1 TiB")
    assert run_command("test", raising(error), as_json=as_json) == 1
    told = capsys.readouterr()
    text = json.loads(told.out)["message"] if as_json else told.err
    assert "Unable to allocate 1 TiB" in text and "smaller tiles" in text and len(text.splitlines()) == 1
    assert run_command("test", raising(MemoryError())) == 1


@pytest.mark.parametrize(
    ("end", "status"),
    [(SystemExit(2), 2), (SystemExit(), 0), (SystemExit("text"), 1), (KeyboardInterrupt(), INTERRUPTED)],
)
def test_however_a_command_ends_there_is_a_status(end, status, capsys):
    assert run_command("test", raising(end)) == status


def test_an_error_of_the_program_itself_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        run_command("test", raising(ZeroDivisionError()))
    assert not isinstance(sys.stdout, GuardedStream)
