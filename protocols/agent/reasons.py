"""Why nothing matched: the first thing that people who run robots ask, and that nobody tells them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def why_nothing(peer: str, state: str, why: str, counts: Mapping[str, Any]) -> dict[str, str]:
    """The reason why a gallery has no verified match, as a code and a sentence.

    Args:
        peer: The other robot.
        state: Of the link: ``connected``, ``waiting``, ``refused``, ``stopped`` or ``destroyed``.
        why: What the link says of that.
        counts: Of the gallery, as :meth:`protocols.agent.turns.Turns.status` gives them.

    Returns:
        ``code`` and ``text``; both empty where there is a verified match.
    """
    matches = counts["matches"]
    if matches.get("verified"):
        return {"code": "", "text": ""}
    code, text = _reason(peer, state, why, counts, sum(matches.values()))
    return {"code": code, "text": text}


def _reason(peer: str, state: str, why: str, counts: Mapping[str, Any], found: int) -> tuple[str, str]:
    matches = counts["matches"]
    if state in ("stopped", "destroyed", "refused"):
        return state, f"{peer} is not compared with any more: {why}"
    if counts["budget_spent"]:
        return "budget-spent", f"this minute's budget with {peer} is spent"
    if not counts["keyframes"]:
        return "no-keyframes", "this robot has no keyframes yet"
    if state != "connected" and not counts["pairs"]:
        return "peer-absent", f"{peer} is not there: {why}"
    if not counts["peer_held"]:
        return "no-peer-keyframes", f"{peer} has no keyframes yet"
    if not found:
        return (
            "below-threshold",
            f"{counts['pairs']:,} pairs were compared with {peer}, none past the threshold",
        )
    if matches.get("candidate"):
        return "unsettled", f"{matches['candidate']} matches with {peer} wait to be shown or verified"
    if matches.get("withheld") == found:
        return "withheld", f"{peer} has shown nothing of {found} matches"
    return "verification-failed", f"{found} matches with {peer}, none of them verified"
