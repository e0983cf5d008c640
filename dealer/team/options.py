"""The dealer's arguments for a mission's plan, and which others go with one."""

from __future__ import annotations

import argparse
from pathlib import Path

_WITH_PLAN = (
    "mission",
    "out",
    "plan",
    "json",
    "quiet",
    "workers",
    "scheduler",
    "tls_ca",
    "tls_cert",
    "tls_key",
    "insecure_plain_tcp",
)
_NEEDED = ("agents", "score", "dim")
_AMOUNTS = ("count", "maps", "slots")


def add_mission(arguments: argparse.ArgumentParser) -> None:
    """Add what a mission's plan is dealt with."""
    arguments.add_argument(
        "mission",
        nargs="?",
        type=Path,
        metavar="mission.toml",
        help="a plan: robots, descriptors, who meets whom; all else but the options below is said in it",
    )
    add = arguments.add_argument_group("with a plan").add_argument
    add("--workers", type=int, metavar="N", help="processes that deal (default: one a core)")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="deal on a Dask cluster: tls://HOST:PORT of its scheduler (needs the package distributed); all "
        "its workers must see --out as the same folder at the same path, and they see the secrets of both "
        "robots of a pair. `local` starts a cluster of --workers processes here",
    )
    add(
        "--tls-ca",
        type=Path,
        metavar="FILE",
        help="with --scheduler: the cluster's certificate authority, PEM",
    )
    add("--tls-cert", type=Path, metavar="FILE", help="with --scheduler: this side's certificate, PEM")
    add("--tls-key", type=Path, metavar="FILE", help="with --scheduler: its key, PEM")
    add(
        "--insecure-plain-tcp",
        action="store_true",
        help="with --scheduler tcp://...: no TLS, beyond this machine; for closed networks only",
    )


def settle(options: argparse.Namespace) -> str | None:
    """Say what is missing, or does not go together; and fill in what is left out.

    Returns:
        A sentence, or None if all is well.
    """
    if options.workers is not None and options.workers < 1:
        return f"--workers: deal with at least one worker, not {options.workers}"
    given = {name for name, value in vars(options).items() if value is not None and value is not False}
    if options.mission is not None:
        if others := sorted(given - set(_WITH_PLAN)):
            return f"{_option(others[0])} does not go with a plan: {options.mission} says it"
        if options.scheduler is None and (others := sorted(given & {"tls_ca", "tls_cert", "tls_key"})):
            return f"{_option(others[0])} is for clusters: give --scheduler as well"
        return None
    if only := sorted(given & {"workers", "scheduler", *_WITH_PLAN[7:]}):
        return f"{_option(only[0])} goes with a plan: give a mission.toml"
    if missing := [_option(name) for name in _NEEDED if name not in given]:
        return (
            f"the following arguments are required: {', '.join(missing)}; or a mission.toml instead of them"
        )
    if not given & set(_AMOUNTS):
        return f"one of the arguments {' '.join(map(_option, _AMOUNTS))} is required"
    options.security = options.security or "malicious"
    options.reveal = options.reveal or "bit"
    return None


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
