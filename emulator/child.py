"""The emulator's process: reads its options from standard input, serves until that is closed."""

import json
import os
import signal
import sys
from collections.abc import Mapping

from emulator.address import parse_address
from emulator.device import EmulatedDevice
from emulator.fault_option import parse_fault_option
from emulator.faults import FaultInjector, load_schedule
from emulator.parameters import load_parameters
from emulator.process import DEFAULT_PORT, EmulatorOptions
from emulator.scheduling import schedule_realtime
from emulator.server import EmulatorServer, LogEntry, OnClientLost, Status
from hm_driver.errors import ConfigurationError, HapticMasterError

_LONGEST_TEXT = 2000


class Outbox:
    """Lines for the parent that never make the writer wait: what finds no room is dropped and counted.

    Args:
        descriptor: Write end of a pipe.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.dropped = 0
        """Lines that found no room."""

    def post(self, message: Mapping[str, object]) -> None:
        """Send one line, or drop it."""
        try:
            os.write(self._descriptor, json.dumps(message).encode() + b"\n")
        except (BlockingIOError, BrokenPipeError):
            self.dropped += 1

    def post_status(self, status: Status) -> None:
        """Send how the server fares."""
        values = {name: getattr(status, name) for name in Status.__slots__}
        self.post({"status": values | {"dropped": self.dropped}})

    def post_log(self, entry: LogEntry) -> None:
        """Send one line of the conversation."""
        self.post({"log": entry._replace(text=entry.text[:_LONGEST_TEXT])._asdict()})


def build_server(options: EmulatorOptions, outbox: Outbox) -> EmulatorServer:
    """Device and server for the options, compiled and warm, ports not yet open.

    Raises:
        ConfigurationError: The arm's constants or the faults are wrong.
    """
    parameters = load_parameters(options.config)
    schedule = [parse_fault_option(text) for text in options.fault]
    if options.faults is not None:
        schedule.extend(load_schedule(options.faults))
    device = EmulatedDevice(parameters, seed=options.seed, init_seconds=options.init_seconds)
    faults = FaultInjector(device, seed=options.seed)
    faults.schedule(schedule)
    return EmulatorServer(
        device,
        faults,
        listen=parse_address("listen", options.listen, default_port=DEFAULT_PORT),
        world=parse_address("world", options.world, default_port=0),
        on_client_lost=OnClientLost(options.on_client_lost),
        is_lockstep=options.lockstep,
        speed=options.speed,
        log=outbox.post_log if options.log is not None else None,
        report=outbox.post_status,
    )


def main() -> int:
    """Run the process; returns its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outbox = Outbox(sys.stdout.fileno())
    try:
        options = EmulatorOptions.from_json(_read_line(0))
        server = build_server(options, outbox)
        server.open()
    except ConfigurationError as error:
        problem = {"field": error.field, "problem": error.problem, "source": error.source}
        outbox.post({"error": {"type": "ConfigurationError", **problem}})
        return 2
    except HapticMasterError as error:
        outbox.post({"error": {"type": type(error).__name__, "problem": str(error)}})
        return 2
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    scheduling = schedule_realtime() if options.realtime else "not asked for"
    outbox.post({"url": server.url, "world_url": server.world_url, "scheduling": str(scheduling)})
    os.set_blocking(sys.stdout.fileno(), False)
    try:
        server.run(lifeline=0)
    finally:
        server.close()
    return 0


def _read_line(descriptor: int) -> str:
    """One line, unbuffered, so that nothing of what follows is taken."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(descriptor, 1)
        if not byte:
            break
        line += byte
    return line.decode()


if __name__ == "__main__":
    sys.exit(main())
