"""What a matching costs on the wire and in memory, foreseen from its program without dealing or running it.

Jobs, rounds and bytes are exact: tests hold them to the counters of real matchings. Memory is an estimate
from above: what a job holds is counted, what its kernels need beside that follows from the largest operands
with factors that were measured on NumPy 2 (``VmHWM`` of a robot's process, all scores), and a test keeps it
between the truth and three times the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

from protocols.batching import jobs_together
from protocols.catalog import Purpose
from spdz.arithmetic.bound import Bound
from spdz.channels.frames import HEADER_BYTES
from spdz.foundations.types import Security, Shape
from spdz.gates.piecewise import Piecewise
from spdz.readings.meter import Meter, Plan, measure
from spdz.readings.program import declare, run
from spdz.rounds.coroutine import Check, Request, run_silently
from spdz.rounds.mac_check import DIGEST_BYTES
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.values import input_mask
from spdz.values.engine import Gate, Input
from spdz.values.value import Value

_FIXED_MEMORY = 12 << 20  # buffers of the channel and of small kernels
_OPERAND_MEMORY = 180  # bytes an element of a product's operands: limbs in floats, and shares beside them
_RESULT_MEMORY = 900  # bytes a result of a product: sums of limbs before they are reduced
_PATH_MEMORY = 220  # bytes a key, point and payload: a comparison's outputs before they are weighted
_DESCRIPTOR_MEMORY = 40  # bytes a coordinate of a robot's own map: as given, quantised, cut into tiles


class Gauge(Meter):
    """The meter, with an eye on bytes and on what one gate needs while it works."""

    def __init__(self, security: Security) -> None:
        """As the meter."""
        super().__init__(security)
        self.checks, self.workspace = 0, 0
        self.shortened = [0, 0]
        self.bit_bytes = 0

    def read(self, gate: Gate, *operands: Any) -> Any:
        """Comparisons need room for every key at every threshold."""
        if isinstance(gate, Piecewise):
            columns = gate.pieces.width * (2 if self.malicious else 1)
            paths = prod(operands[0].shape) * len(gate.pieces.thresholds) * columns
            self.workspace = max(self.workspace, _PATH_MEMORY * paths)
        return super().read(gate, *operands)

    def shared_value(
        self, kind: str, of: tuple[Value, ...], shape: Shape, frac: int, bound: Bound, *, is_bit: bool = False
    ) -> Value:
        """Products need room for both operands and their results."""
        if len(of) > 1:
            operands = sum(prod(value.shape) for value in of)
            needed = _OPERAND_MEMORY * operands + _RESULT_MEMORY * prod(shape)
            self.workspace = max(self.workspace, needed)
        return super().shared_value(kind, of, shape, frac, bound, is_bit=is_bit)

    def input_mask(self, source: Input) -> Value:
        """Inputs under short masks travel in fewer bytes."""
        saved = ELEMENT_BYTES - input_mask.element_bytes(self.input_mask_bits(source))
        self.shortened[source.owner] += saved * prod(source.shape)
        return super().input_mask(source)

    async def opening_bits(self, bits: int) -> None:
        """Bits travel eight to a byte, the same number from either party."""
        self.bit_bytes += -(-bits // 8)
        await super().opening_bits(bits)

    def on_request(self, request: Request) -> None:
        """Count checks by themselves."""
        super().on_request(request)
        self.checks += isinstance(request, Check)


@dataclass(frozen=True, slots=True)
class JobCost:
    """What one job of a purpose costs.

    Attributes:
        plan: The meter's plan.
        checks: MAC checks among its rounds.
        payload_bytes: What either party sends, without frame headers and checks.
        workspace: Memory that its most demanding gate needs for a moment, in bytes.
        together: Jobs that share rounds.
    """

    plan: Plan
    checks: int
    payload_bytes: tuple[int, int]
    workspace: int
    together: int


def job_cost(purpose: Purpose, security: Security) -> JobCost:
    """Read a purpose's program for its costs.

    Raises:
        ValueError: if the engine refuses the program.
    """
    program = purpose.dealt_program
    gauge = Gauge(security)
    run_silently(run(gauge, program, declare(program, purpose.shapes)), gauge.on_request)
    plan = measure(program, purpose.shapes, security)
    sent = [
        ELEMENT_BYTES * n - gauge.shortened[party] + gauge.bit_bytes
        for party, n in enumerate(plan.elements_sent)
    ]
    together = jobs_together(purpose.tile, purpose.dim, plan.correction_bytes)
    return JobCost(plan, gauge.checks, (sent[0], sent[1]), gauge.workspace, together)


def rounds(cost: JobCost, jobs: int) -> int:
    """Rounds of a matching of so many jobs; the greeting and the agreements are not counted."""
    return -(-jobs // cost.together) * cost.plan.rounds


def most_jobs_lost(cost: JobCost, jobs: int) -> int:
    """Jobs of a matching of so many that one interruption can cost at most.

    The jobs that were under way, and as many again where one robot had already begun on the next ones when
    the other one missed the last frame: both sets are used on one tape at least, and run again.
    """
    return min(jobs, 2 * cost.together)


def bytes_sent(cost: JobCost, jobs: int) -> tuple[int, int]:
    """What either party sends in these rounds, frame headers included, TLS and TCP not."""
    batches = -(-jobs // cost.together)
    frames = batches * (cost.plan.rounds * HEADER_BYTES + cost.checks * DIGEST_BYTES)
    first, second = (jobs * payload + frames for payload in cost.payload_bytes)
    return first, second


def matching_memory(cost: JobCost, jobs: int, coordinates: int) -> int:
    """Memory that a robot needs beside the interpreter's own, in bytes, an estimate from above.

    Args:
        cost: What one job costs.
        jobs: Jobs of the matching.
        coordinates: Of all of the robot's own descriptors, N each.
    """
    jobs = min(jobs, cost.together)
    held = 2 * max(cost.plan.pad_bytes) + max(cost.plan.correction_bytes)
    frames = 6 * max(cost.payload_bytes)
    return _FIXED_MEMORY + jobs * (held + frames) + cost.workspace + _DESCRIPTOR_MEMORY * coordinates
