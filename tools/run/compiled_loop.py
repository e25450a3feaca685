"""The driver's loop in lock-step with the emulator, compiled: one call runs the cycles of a tick.

Nothing is left out: in every cycle the client writes its request as text, the emulator reads it and writes
its reply as text, and the client reads that. What is unusual is handed to Python, in the middle of a cycle if
need be: a request that the emulator's phrases do not know goes over the link as it is; a reply that is no
plain measurement, a trip or a silent application ends the compiled loop, and the interpreted one takes over
from its `checkpoint`.
"""

import math
from typing import Final

from emulator.compilation import entry_point
from emulator.grid import STEP_RATE_HZ
from emulator.in_process import Arm, LockstepEmulator
from emulator.kernels import advance
from emulator.layout import O_GUARD
from emulator.phrases import Book, answer
from hm_driver.device.link import CommandLink
from hm_driver.errors import HapticMasterError
from hm_driver.realtime import cycle
from hm_driver.realtime.checkpoint import Checkpoint
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.core import STATE_EVERY_S, Recording
from hm_driver.realtime.options import WatchOptions
from hm_driver.realtime.segment import Segment, Word
from hm_driver.recording.schemas import LOOP_BUNDLE
from tools.run.client_kernels import (
    MOST_CYCLES,
    N_CYCLES,
    N_REPLY,
    N_REQUEST,
    N_SAID,
    N_STAGE,
    N_STEP,
    RECORD,
    Client,
    Records,
    ask,
    make_client,
    make_records,
    pack_record,
    take_reply,
)

# Stages of a cycle.
BEGIN: Final = 0
"""The emulator has to be run up to the cycle's deadline."""
ASK: Final = 1
"""The request has to be written, and answered."""
TAKE: Final = 2
"""The reply is there."""

# What a call returns.
DONE: Final = 0
ADVANCE: Final = 1
"""Python has to run the emulator up to the cycle's deadline."""
EXCHANGE: Final = 2
"""Python has to have the request answered."""
UNUSUAL: Final = 3
"""The interpreted loop has to take the reply."""

_SECOND_NS: Final = 1_000_000_000


@entry_point
def run_cycles(
    arm: Arm,
    active_effects: int,
    book: Book,
    next_step: int,
    is_plain: bool,  # noqa: FBT001  # flat scalars, for the compiler
    client: Client,
    records: Records,
    first: int,
    until: int,
    start_ns: int,
    period_ns: int,
    epoch_ns: int,
    state_every: int,
) -> int:
    """Run cycles until so many have been run since the start, or Python is needed.

    Args:
        arm: The emulator.
        active_effects: How many of its effects are enabled.
        book: Requests that it answers here.
        next_step: Step of the emulator from which on Python has to run it.
        is_plain: Whether requests may be answered here.
        client: The loop's memory.
        records: Where the records go.
        first: Cycle whose record goes into row 0.
        until: Number of cycles since the start of the loop.
        start_ns: Deadline 0 on the virtual clock [ns].
        period_ns: Time between two cycles [ns].
        epoch_ns: Time of the log minus time of the clock [ns].
        state_every: Cycles between two questions for the state.
    """
    counts = client.counts
    dt = period_ns * 1e-9
    while counts[N_CYCLES] < until:
        index = counts[N_CYCLES]
        time_ns = start_ns + index * period_ns
        is_state_asked = (index + 1) % state_every == 0
        if counts[N_STAGE] == BEGIN:
            due = time_ns * STEP_RATE_HZ // _SECOND_NS
            if due >= next_step:
                return ADVANCE
            if due > counts[N_STEP]:
                counts[N_STEP] += advance(
                    arm.state,
                    arm.params,
                    arm.effects,
                    arm.active,
                    active_effects,
                    arm.outputs,
                    due - counts[N_STEP],
                )
                if arm.outputs[O_GUARD] != 0.0:
                    return ADVANCE
            counts[N_STAGE] = ASK
        if counts[N_STAGE] == ASK:
            ask(client, is_state_asked)
            counts[N_REPLY] = 0
            if is_plain:
                counts[N_REPLY] = answer(
                    client.request,
                    counts[N_REQUEST],
                    book.texts,
                    book.fields,
                    book.limits,
                    arm.effects,
                    arm.outputs,
                    client.reply,
                )
            if counts[N_REPLY] == 0:
                return EXCHANGE
            counts[N_STAGE] = TAKE
        if not take_reply(client, is_state_asked, dt):
            return UNUSUAL
        pack_record(client, records, index - first, index, time_ns + epoch_ns, dt)
        counts[N_CYCLES] += 1
        counts[N_STAGE] = BEGIN
    return DONE


class CompiledLoop:
    """The loop from its first cycle up to whatever is unusual.

    Args:
        link: Connection to the emulator, which takes combined requests.
        emulator: The emulator at its other end, which the clock runs too.
        clock: The virtual clock.
        segment: Where set-points come from, and the state goes.
        start_ns: Deadline 0 [ns].
        period_ns: Time between two cycles [ns].
        parameters: Flat parameters of the cycle function.
        watch: Time-outs.
        recording: Where the records go.
        session_state: Device state that the loop needs.
    """

    def __init__(
        self,
        link: CommandLink,
        emulator: LockstepEmulator,
        clock: VirtualClock,
        segment: Segment,
        *,
        start_ns: int,
        period_ns: int,
        parameters: list[float],
        watch: WatchOptions,
        recording: Recording,
        session_state: str = "force",
    ) -> None:
        self._link = link
        self._emulator = emulator
        self._clock = clock
        self._segment = segment
        self._start_ns = start_ns
        self._period_ns = period_ns
        self._recording = recording
        self._client = make_client(parameters, session_state)
        self._client.counts[N_STEP] = emulator.device.step
        self._records = make_records()
        self._rows = self._records.rows.data
        self._state_every = max(1, round(STATE_EVERY_S * 1e9 / period_ns))
        self._set_point_count = segment.set_points.count
        self._heartbeat = segment.words[Word.APP_HEARTBEAT_NS]
        self._silence_ns = -1
        self._silence_limit_ns = int(watch.heartbeat_s * 1e9)
        self.reply: bytes | HapticMasterError | None = None
        """What the link made of the request of the cycle in which the loop ended; None between two cycles."""

    @property
    def cycles(self) -> int:
        """Cycles run."""
        return int(self._client.counts[N_CYCLES])

    @property
    def request(self) -> bytes:
        """The last request, as it went to the emulator."""
        client = self._client
        return client.request[: client.counts[N_REQUEST]].tobytes()

    def run_to(self, cycles: int) -> bool:
        """Run cycles until so many have been run; False where the interpreted loop has to go on."""
        if not self._look_around(cycles - self.cycles):
            return False
        while (first := self.cycles) < cycles:
            is_usual = self._run(first, min(cycles, first + MOST_CYCLES))
            done = self.cycles
            if done > first:
                self._publish(first, done)
            if not is_usual:
                return False
        return True

    def checkpoint(self) -> Checkpoint:
        """Where the loop stands, for the interpreted one."""
        client = self._client
        told = client.told.tolist()
        springs = cycle.SPRINGS * cycle.SPRING_STRIDE
        said = client.changes[: client.counts[N_SAID]].tobytes().decode()
        return Checkpoint(
            cycles=self.cycles,
            state=client.s.tolist(),
            set_point=client.u.tolist(),
            measurement=client.m.tolist(),
            changes=said.split("; ")[:-1],
            told=told[:springs],
            enabled=[bool(is_on) for is_on in client.enabled],
            bias=(told[springs], told[springs + 1], told[springs + 2]),
            heartbeat=self._heartbeat,
            silence_ns=self._silence_ns,
        )

    def _look_around(self, cycles: int) -> bool:
        """Take the newest set-point; whether the application is near enough for so many cycles."""
        segment = self._segment
        count = segment.set_points.count
        if count != self._set_point_count:
            set_point = segment.set_points.read()
            if not math.isfinite(sum(set_point)):
                return False
            self._set_point_count = count
            self._client.u[:] = set_point
        if segment.words[Word.STOP_REQUESTED]:
            return False
        heartbeat = segment.words[Word.APP_HEARTBEAT_NS]
        silence_ns = self._silence_ns
        if heartbeat != self._heartbeat:
            silence_ns = (cycles - 1) * self._period_ns
        elif silence_ns >= 0:
            silence_ns += cycles * self._period_ns
        if silence_ns > self._silence_limit_ns > 0:
            return False
        self._heartbeat, self._silence_ns = heartbeat, silence_ns
        return True

    def _run(self, first: int, until: int) -> bool:
        counts, emulator = self._client.counts, self._emulator
        done = first
        while True:
            inside = emulator.inside()
            code = run_cycles(
                inside.arm,
                inside.active_effects,
                inside.book,
                inside.next_step,
                inside.is_plain,
                self._client,
                self._records,
                first,
                until,
                self._start_ns,
                self._period_ns,
                self._recording.epoch_ns,
                self._state_every,
            )
            before, done = done, self.cycles
            emulator.ran_to(int(counts[N_STEP]), done - before)
            self._clock.sleep_until_ns(self._deadline_ns(min(done, until - 1)))
            if code == DONE:
                return True
            if code == ADVANCE:
                counts[N_STEP] = emulator.device.step
                counts[N_STAGE] = ASK
            elif code == EXCHANGE:
                if not self._exchange():
                    return False
            else:
                self.reply = self._client.reply[: counts[N_REPLY]].tobytes()
                return False

    def _exchange(self) -> bool:
        """Have the request answered over the link; whether it was."""
        client = self._client
        try:
            reply = self._link.exchange_line(self.request)
        except HapticMasterError as error:
            self.reply = error
            return False
        if len(reply) > len(client.reply):
            self.reply = reply
            return False
        client.reply[: len(reply)] = list(reply)
        client.counts[N_REPLY] = len(reply)
        client.counts[N_STAGE] = TAKE
        return True

    def _deadline_ns(self, index: int) -> int:
        return self._start_ns + index * self._period_ns

    def _publish(self, first: int, cycles: int) -> None:
        """Publish the last cycle, and record all from the first on."""
        s, m = self._client.s.tolist(), self._client.m.tolist()
        last_ns = self._deadline_ns(cycles - 1)
        ring, epoch_ns = self._recording
        first_ns = self._deadline_ns(first) + epoch_ns
        rows = self._rows[: (cycles - first) * RECORD]
        ring.write_series(LOOP_BUNDLE.id, first_ns, self._period_ns, rows, RECORD)
        axes = cycle.AXES * cycle.SPRING_STRIDE
        references = s[cycle.REFERENCE : axes : cycle.SPRING_STRIDE]
        phases = s[cycle.PHASE : axes : cycle.SPRING_STRIDE]
        forces = s[cycle.S_FORCE : cycle.S_FORCE + cycle.SPRINGS]
        self._segment.publish_state(
            (
                cycles,
                last_ns,
                0,
                s[cycle.S_SATURATED],
                *m,
                *references,
                *forces[: cycle.AXES],
                *phases,
                forces[cycle.ASSIST],
            )
        )
        words = self._segment.words
        words[Word.CYCLES] = words[Word.GRID_LENGTH] = words[Word.EXCHANGES] = cycles
        words[Word.LOOP_HEARTBEAT_NS] = last_ns
