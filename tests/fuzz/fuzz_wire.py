"""Any bytes at all, for hours: ``python tests/fuzz/fuzz_wire.py -max_total_time=3600``.

Needs ``pip install atheris``; not part of the test run. Bytes go through decoder, interpreter and device, and
as lines to the world endpoint; nothing may be raised, and every reply must be one that a client can read.
"""

import json
import sys

import atheris

# The compiled kernels cannot be instrumented, so they are imported before.
import emulator.arm_model  # noqa: F401 - see above

INSTRUMENTED = ["device", "faults", "fast_requests", "in_process", "interpreter", "world_service"]

with atheris.instrument_imports(
    include=["hm_driver.protocol", *(f"emulator.{name}" for name in INSTRUMENTED)]
):
    from emulator.in_process import LockstepEmulator
    from hm_driver.protocol.framing import HEADER

WORDS = (
    b"get measpos\n",
    b"set state init\n",
    b"set state force\n",
    b"create spring s\n",
    b"create torus t\n",
    b"set s pos [0,0,0.1]; get measpos; set s vel [1,2,3]\n",
    b"set s enable\n",
    b"set t stiffness 100\n",
    b"remove all\n",
)
device = LockstepEmulator(init_seconds=0.1)


def check_replies(reply: bytes) -> None:
    """Text lines or frames, whole, ASCII."""
    reply.decode("ascii")
    while reply:
        if reply[0] == 0:
            length, zero = HEADER.unpack_from(reply)
            if zero or HEADER.size + length > 127 or len(reply) < HEADER.size + length:
                raise RuntimeError(f"broken frame {reply[:200]!r}")
            reply = reply[HEADER.size + length :]
        else:
            line, end, reply = reply.partition(b"\n")
            if not end or not line.endswith(b";"):
                raise RuntimeError(f"broken line {line[:200]!r}")


def one_input(data: bytes) -> None:
    """One run: a choice of sensible commands, then the bytes, cut in two."""
    provider = atheris.FuzzedDataProvider(data)
    for _ in range(provider.ConsumeIntInRange(0, 3)):
        check_replies(device.handle(WORDS[provider.ConsumeIntInRange(0, len(WORDS) - 1)]))
    kind = provider.ConsumeIntInRange(0, 2)
    rest = provider.ConsumeBytes(4000)
    if kind == 0:
        check_replies(device.handle(HEADER.pack(len(rest), 0) + rest))
    elif kind == 1:
        cut = provider.ConsumeIntInRange(0, len(rest))
        check_replies(device.handle(rest[:cut]) + device.handle(rest[cut:] + b"\n"))
    else:
        json.loads(device.world._service.answer(rest))
    device.advance_to_ns(device.device.step * 400_000 + 800_000)
    device.faults.clear()
    while not device._is_between_requests:
        device._begin_anew()
    if device.handle(b"get os\n") != b"Linux;\n":
        raise RuntimeError("the emulator does not answer any more")


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
