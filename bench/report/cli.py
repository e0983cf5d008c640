"""``python -m bench report``: a results folder as tables and plots."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from bench.out import out_folder
from bench.report.cells import MODELS
from bench.report.folder import BadResults, read_results
from spdz.console.command import CommandParser, run_command, say_error

NEEDS = ("matplotlib>=3.8.4",)
"""What the report needs beyond the engine; it is in the extra ``demo``."""
DEFAULT = Path("bench-results")
TITLE = "A private comparison: what it costs"

_EPILOG = """\
Reads what other commands wrote into a folder:

  sweep.json, trials.jsonl   by `python -m bench sweep`; without them there is no report
  versus.json                by `python -m bench versus COMMIT --out FOLDER`
  gallery.jsonl              by `python -m bench gallery --compare --json > FOLDER/gallery.jsonl`

and writes beside them:

  report.html   one page without scripts that needs no other file and no network
  report.md     the same tables
  report.png    time against N, ours beside MP-SPDZ's recorded

In them: the paper's table with ours, what the paper prints and what was recorded of MP-SPDZ; ratios; how far
times are above a bare socket's and above no security; galleries beside batched engines; where the time goes.
What was not measured is named as missing.

Exit status: 0 done, 1 it failed, 2 bad arguments or a damaged folder.

examples:
  python -m bench sweep --quick && python -m bench report
  python -m bench report /data/results --out docs/benchmarks --json
"""


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench report``."""
    arguments = CommandParser(
        prog="python -m bench report",
        description="Write tables and plots of a results folder.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("folder", nargs="?", type=Path, default=DEFAULT, metavar="FOLDER", help=f"results ({DEFAULT})")
    add("--out", type=Path, metavar="DIR", help="where the report goes (into FOLDER)")
    add("--json", action="store_true", help="one JSON object on standard output: files, gaps, means")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Write the report; returns the exit status."""
    options = parser().parse_args(argv)
    return run_command("python -m bench report", lambda: _run(options), as_json=options.json)


def _run(options: argparse.Namespace) -> int:
    name = "python -m bench report"
    try:
        results = read_results(options.folder)
        from bench.report.markdown import PICTURE, markdown
        from bench.report.page import page
        from bench.report.picture import picture
        from bench.report.sections import mean_factors, sections

        out = out_folder(options.out or options.folder)
        parts, drawn = list(sections(results)), picture(results)
        files = {"page": out / "report.html", "markdown": out / "report.md"}
        files["page"].write_text(page(TITLE, parts), encoding="utf-8")
        text = markdown(TITLE, parts, pictured=drawn is not None)
        files["markdown"].write_text(text, encoding="utf-8")
        if drawn is not None:
            files["picture"] = out / PICTURE
            files["picture"].write_bytes(drawn)
    except BadResults as error:
        say_error(name, "BadResults", str(error), as_json=options.json)
        return 2
    except ImportError as error:
        command = shlex.join([sys.executable, "-m", "pip", "install", *NEEDS])
        message = f"{error}. The report needs more than the engine: {command}"
        say_error(name, "ImportError", message, as_json=options.json)
        return 1
    except OSError as error:
        say_error(name, type(error).__name__, str(error), as_json=options.json)
        return 1
    missing = len(results.missing())
    if options.json:
        means = {model: mean_factors(results, model) for model in MODELS}
        told = {what: str(path) for what, path in files.items()}
        print(json.dumps({**told, "cells": len(results.cells), "missing": missing, "geometric_means": means}))
        return 0
    print(f"{len(results.cells)} cells, {missing} of the paper's sweep not run")
    for what, path in files.items():
        print(f"{what:10}{path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
