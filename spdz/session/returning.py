"""The first thing that two sides of a gallery do when they meet: compare accounts, and act on it."""

from __future__ import annotations

from spdz.foundations.errors import TapeMismatch
from spdz.readings.gallery_plan import GalleryPlan
from spdz.session.admission import check_rule
from spdz.session.agreement import Agreement
from spdz.session.filling import Filling
from spdz.session.handshake import shown
from spdz.session.meeting import Agreed, Standpoint, meet
from spdz.session.strips import within


def meet_again(agreement: Agreement, filling: Filling, plan: GalleryPlan) -> Agreed:
    """Compare accounts, make void what either has lost, and burn what cannot be run again.

    Raises:
        TapeMismatch: if this gallery, or the peer, computes something else, or they differ by more than one
            step of an honest run.
        ProtocolViolation: if the peer's account is malformed.
    """
    ledger, terms, header = filling.ledger, filling.terms, filling.tape.header
    own = Standpoint.of(ledger)
    account = {**own.as_json(), "text": plan.text, "rule": terms.rule[:120]}
    answer = agreement.control(account, *account)
    check_rule(ledger.text, plan, terms)
    if answer["text"] != plan.text:
        raise TapeMismatch(
            f"the peer computes {shown(answer['rule'], 120)} and this side {terms.rule}: give both robots "
            "the same threshold and program"
        )
    agreed = meet(own, Standpoint.read(answer, header.capacity), filling.party, plan)
    mine = ledger.slots[filling.party]
    mine.fill([(mine.filled + i, None) for i in range(agreed.lost)])
    ready = agreed.ready[filling.party]
    filling.take_back([slot for slot in agreed.void[filling.party] if slot >= ready])
    for slots, void in zip(ledger.slots, agreed.void, strict=True):
        slots.void(void)
    for strip in agreed.burn:
        if not within(strip, ledger.done):
            ledger.burn(strip)
    filling.sent = agreed.send
    return agreed
