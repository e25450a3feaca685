"""The guardian: a process with a connection of its own that stops the device when the loop no longer can.

It watches the loop's heartbeat, the loop's process and its own parent, and it sends ``set state stop`` when

- the loop's process ends without having stopped the device,
- the loop's heartbeat stays away (it froze, or is stopped),
- the loop lost its link, or ended in an error, with the device not stopped,
- the application is gone and the loop does not end by itself.

What it did is in the segment. When the link itself is cut it can do nothing: that is what the emergency
button is for.
"""

import contextlib
import os
import select
import signal
import time
from dataclasses import dataclass

from hm_driver.device.link import CommandLink, connect_link
from hm_driver.errors import DeviceError, HapticMasterError
from hm_driver.realtime import bring_up
from hm_driver.realtime.child import receive_argument
from hm_driver.realtime.scheduling import enter_realtime, prepare_process
from hm_driver.realtime.segment import GuardianStatus, Segment, Status, Trip, Word
from hm_driver.realtime.shared import SharedBlock

_POLL_MS = 5
_ORPHAN_NS = 50_000_000
_STOP_TIMEOUT_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardianOptions:
    """What a guardian is told at its start."""

    url: str
    """The device."""
    segment: str
    """Path of the loop's segment."""
    freeze_s: float = 0.06
    """Silence of the loop after which the device is stopped [s]; 0 for none."""
    connect_timeout_s: float = 1.0
    """How long the connection may take [s]."""
    priority: int = 85
    """SCHED_FIFO priority that is asked for; above the loop's, which may hang."""


class Guardian:
    """Watches one loop until it ends, or ends it.

    Args:
        options: What to watch.
        segment: The loop's segment.
        link: Connection of its own, which is used for the stop alone.
    """

    def __init__(self, options: GuardianOptions, segment: Segment, link: CommandLink) -> None:
        self._options = options
        self._segment = segment
        self._link = link
        self._freeze_ns = int(options.freeze_s * 1e9)
        self._beat = 0
        self._silence_ns = 0
        self._orphan_ns = -1
        self._last_ns = time.monotonic_ns()

    @property
    def is_orphan(self) -> bool:
        """Whether the application is gone."""
        return self._orphan_ns >= 0

    def watch(self, poll: "select.poll", loop_fd: int | None) -> None:
        """Watch until the loop has ended and the device is stopped.

        Args:
            poll: Knows standard input, whose end is the application's, and ``loop_fd``.
            loop_fd: Descriptor that becomes readable when the loop's process ends, or None.
        """
        segment = self._segment
        while True:
            ready = {fd for fd, _ in poll.poll(_POLL_MS)}
            now_ns = time.monotonic_ns()
            segment.words[Word.GUARDIAN_HEARTBEAT_NS] = now_ns
            if 0 in ready and not os.read(0, 64):
                poll.unregister(0)
                self._orphan_ns = now_ns
            reason = self._reason_to_stop(now_ns, loop_has_died=loop_fd in ready)
            if reason:
                self._stop(reason, now_ns)
                return
            if segment.status.has_ended or loop_fd in ready:  # a dead process stays readable: do not poll on
                segment.words[Word.GUARDIAN] = GuardianStatus.ENDED
                return

    def _reason_to_stop(self, now_ns: int, *, loop_has_died: bool) -> str:
        words, status = self._segment.words, self._segment.status
        elapsed_ns, self._last_ns = now_ns - self._last_ns, now_ns
        if not words[Word.DEVICE_TOUCHED] or words[Word.STOPPED_NS]:
            return ""
        if status.has_ended:
            return f"the loop ended as {status.name.lower()} without having stopped the device"
        if loop_has_died:
            return "the loop's process died"
        if 0 <= self._orphan_ns < now_ns - _ORPHAN_NS:
            return "the application is gone, and the loop did not stop the device"
        beat = words[Word.LOOP_HEARTBEAT_NS]
        if beat != self._beat or status not in (Status.RUNNING, Status.STOPPING):
            self._beat = beat
            self._silence_ns = 0
            return ""
        self._silence_ns += min(elapsed_ns, 2 * _POLL_MS * 1_000_000)
        if 0 < self._freeze_ns < self._silence_ns:
            return f"the loop gave no sign of life for {self._silence_ns * 1e-6:.0f} ms"
        return ""

    def _stop(self, reason: str, noticed_ns: int) -> None:
        segment = self._segment
        segment.words[Word.GUARDIAN_NOTICED_NS] = noticed_ns
        segment.set_trip(Trip.LOOP_LOST, reason, noticed_ns)
        try:
            self._send_stop()
        except HapticMasterError as error:
            segment.write_text("guardian", f"{reason}; the device could not be stopped: {error}")
            segment.words[Word.GUARDIAN] = GuardianStatus.FAILED
            return
        segment.words[Word.GUARDIAN_STOPPED_NS] = time.monotonic_ns()
        segment.write_text("guardian", f"{reason}; the device was stopped")
        segment.words[Word.GUARDIAN] = GuardianStatus.STOPPED_DEVICE

    def _send_stop(self) -> None:
        """Stop the device over the connection that is there, or else over a new one."""
        try:
            bring_up.make_safe(self._link)
        except DeviceError:
            raise  # it was told, and would refuse again
        except HapticMasterError:
            link = connect_link(self._options.url, timeout_s=self._options.connect_timeout_s)
            try:
                bring_up.make_safe(link)
            finally:
                link.close()


def main() -> None:
    """Run the guardian that the parent describes on standard input."""
    options = receive_argument()
    if not isinstance(options, GuardianOptions):
        raise SystemExit(2)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends with the loop, and not before
    with SharedBlock.attach(options.segment) as block:
        segment = Segment(block.buffer)
        segment.words[Word.GUARDIAN_PID] = os.getpid()
        try:
            link = connect_link(options.url, timeout_s=options.connect_timeout_s)
        except HapticMasterError as error:
            segment.write_text("guardian", str(error))
            segment.words[Word.GUARDIAN] = GuardianStatus.FAILED
            return
        try:
            if _watch(options, segment, link):
                block.path.unlink(missing_ok=True)  # its owner is gone
        finally:
            link.close()
            segment.close()


def _watch(options: GuardianOptions, segment: Segment, link: CommandLink) -> bool:
    """Watch until the end; whether the application is gone."""
    link.timeout_s = _STOP_TIMEOUT_S
    prepare_process()
    granted = enter_realtime(options.priority, hold_dma_latency=False)
    poll = select.poll()
    poll.register(0, select.POLLIN | select.POLLHUP)
    loop_fd = _open_process(int(segment.words[Word.LOOP_PID]))
    if loop_fd is not None:
        poll.register(loop_fd, select.POLLIN)
    segment.words[Word.GUARDIAN] = GuardianStatus.WATCHING
    guardian = Guardian(options, segment, link)
    try:
        guardian.watch(poll, loop_fd)
    finally:
        granted.release()
        if loop_fd is not None:
            os.close(loop_fd)
    return guardian.is_orphan


def _open_process(pid: int) -> int | None:
    """Descriptor that becomes readable when a process ends; None where the platform has none."""
    with contextlib.suppress(OSError):
        if pid > 0 and hasattr(os, "pidfd_open"):
            return os.pidfd_open(pid)
    return None
