"""Questions that move nothing and leave the state as it is."""

import itertools
import math
import re
import statistics
import time
from collections.abc import Callable

from hm_driver.errors import ProtocolError
from hm_driver.geometry import ArmGeometry, joint_to_cartesian
from hm_driver.protocol.replies import parse_number, parse_vector
from hm_driver.protocol.vocabulary import ERROR_MARK, State, Vector
from tools.check.comparison import Answer, Conversation, Question, Verdict, judge

_ARM = ArmGeometry()
_END_STOP_TOLERANCE = 0.02
"""How far one arm's end stops may be from another's [m], [rad]: they are set where it stands."""
_R0_TOLERANCE_M = 0.02
_KINEMATICS_TOLERANCE_M = 2e-3
_NOISE_N = 0.015
_NOISE_SAMPLES = 200
_NOISE_APART_S = 0.002
"""Several periods of the device, so that no reading is taken twice."""
_DIGITS = re.compile(r"^-?(?:\d+\.?\d*|\.\d+)(?:e[-+]\d+)?$")


def _word(command: str, *allowed: str) -> Callable[[Conversation], Answer]:
    def ask(conversation: Conversation) -> Answer:
        got = conversation.ask(command)
        return judge(" or ".join(allowed), got, is_same=got in allowed)

    return ask


def _vector(conversation: Conversation, quantity: str) -> Vector | None:
    try:
        return parse_vector(conversation.ask(f"get {quantity}"))
    except ProtocolError:
        return None


def _number(command: str, *, low: float, unit: str) -> Callable[[Conversation], Answer]:
    def ask(conversation: Conversation) -> Answer:
        got = conversation.ask(command)
        try:
            is_same = parse_number(got) >= low
        except ProtocolError:
            is_same = False
        return judge(f"a number of at least {low:g} {unit}", got, is_same=is_same)

    return ask


def _vectors(*quantities: str) -> Callable[[Conversation], Answer]:
    def ask(conversation: Conversation) -> Answer:
        missing = [name for name in quantities if _vector(conversation, name) is None]
        got = f"none from {', '.join(missing)}" if missing else "one each"
        return judge(f"a vector each from {', '.join(quantities)}", got, is_same=not missing)

    return ask


def _end_stops(conversation: Conversation) -> Answer:
    told, is_same = [], True
    for joint, _, low, high in _ARM.joint_limits():
        vector = _vector(conversation, f"workspace_{joint}")
        if vector is None:
            return Answer("three vectors", "not three vectors", Verdict.DIFFERS)
        told.append(f"{joint} {vector[0]:g} to {vector[2]:g}")
        off = max(abs(vector[0] - low), abs(vector[2] - high))
        is_same = is_same and off <= _END_STOP_TOLERANCE
    expected = ", ".join(f"{joint} {low:g} to {high:g}" for joint, _, low, high in _ARM.joint_limits())
    return judge(f"{expected}, each within {_END_STOP_TOLERANCE:g}", ", ".join(told), is_same=is_same)


def _column(conversation: Conversation) -> Answer:
    vector = _vector(conversation, "workspace_r")
    got = "" if vector is None else f"{vector[1]:g} m"
    is_same = vector is not None and abs(vector[1] - _ARM.r0) <= _R0_TOLERANCE_M
    return judge(f"{_ARM.r0:g} m within {_R0_TOLERANCE_M:g} m", got, is_same=is_same)


def _kinematics(conversation: Conversation) -> Answer:
    column = _vector(conversation, "workspace_r")
    joints = _vector(conversation, "measposjoint")
    place = _vector(conversation, "measpos")
    expected = f"both agree within {_KINEMATICS_TOLERANCE_M * 1e3:g} mm"
    if column is None or joints is None or place is None:
        return Answer(expected, "not told", Verdict.UNKNOWN)
    apart_m = math.dist(joint_to_cartesian(*joints, column[1]), place)
    return judge(expected, f"{apart_m * 1e3:.2f} mm apart", is_same=apart_m <= _KINEMATICS_TOLERANCE_M)


def _format(conversation: Conversation) -> Answer:
    got = conversation.ask("get measpos")
    numbers = got.strip("[]").split(",")
    is_same = len(numbers) == 3 and all(_is_short(number) for number in numbers)
    return judge("as %g: 6 significant digits at most", got, is_same=is_same)


def _is_short(number: str) -> bool:
    digits = re.sub(r"e.*$|[-.]", "", number).lstrip("0")
    return bool(_DIGITS.match(number)) and len(digits) <= 6


def _refusal(command: str) -> Callable[[Conversation], Answer]:
    def ask(conversation: Conversation) -> Answer:
        got = conversation.ask(command)
        return judge(f"a refusal with {ERROR_MARK}", got, is_same=ERROR_MARK in got)

    return ask


def _combined(conversation: Conversation) -> Answer:
    if conversation.dialect != "text":
        return Answer("three parts", "not asked in the framed dialect", Verdict.UNKNOWN)
    got = conversation.ask("get modelpos; get modelvel; get measforce")
    is_same = got.count("];[") == 2
    return judge("[..];[..];[..]; in one reply", got, is_same=is_same)


def _second_client(conversation: Conversation) -> Answer:
    got = conversation.ask_beside()
    return judge("a second connection is answered", got or "it is not", is_same=bool(got))


def _noise(conversation: Conversation) -> Answer:
    readings = []
    for _ in range(_NOISE_SAMPLES):
        readings.append(_vector(conversation, "measforce"))
        time.sleep(_NOISE_APART_S)
    values = [vector for vector in readings if vector is not None]
    expected = f"{_NOISE_N:g} N rms within a factor of 3"
    if len(values) < _NOISE_SAMPLES:
        return Answer(expected, "not told", Verdict.UNKNOWN)
    steps = [
        math.dist(one, before) / math.sqrt(6.0) for before, one in itertools.pairwise(values)
    ]  # white noise of three axes; a slow drift or a hand hardly counts
    rms = math.sqrt(statistics.fmean(step * step for step in steps))
    return judge(expected, f"{rms:.4f} N rms", is_same=_NOISE_N / 3.0 <= rms <= 3.0 * _NOISE_N)


PASSIVE = (
    Question(
        name="state",
        fact="states off, init, stop, position, force, home",
        confidence="H",
        ask=_word("get state", *(state.value for state in State if state is not State.FAULT)),
    ),
    Question(
        name="operating system",
        fact="names of commands and parameters, reply texts, `Shapes's stiffness set`",
        confidence="H, M",
        ask=_word("get os", "Linux"),
    ),
    Question(
        name="emergency button",
        fact="emergency button and relay can be asked for",
        confidence="M",
        ask=_word("get emergencybuttonpushed", "true", "false"),
    ),
    Question(
        name="emergency relay",
        fact="emergency button and relay can be asked for",
        confidence="M",
        ask=_word("get emergencyrelay", "true", "false"),
    ),
    Question(
        name="calibration",
        fact="`init` calibrates the force sensor, searches the end stops, goes to `stop` by itself",
        confidence="H",
        ask=_word("get position_calibrated", "true", "false"),
    ),
    Question(
        name="virtual mass",
        fact="virtual mass at least 2 kg; 1 to 8 asked for by programs",
        confidence="H",
        ask=_number("get inertia", low=2.0, unit="kg"),
    ),
    Question(
        name="friction",
        fact="`coulombfriction` exists",
        confidence="H",
        ask=_number("get coulombfriction", low=0.0, unit="N"),
    ),
    Question(
        name="measurements",
        fact="admittance: force sensor -> virtual mass with effects -> position, velocity, acceleration "
        "set-points",
        confidence="H",
        ask=_vectors("measpos", "measvel", "measforce", "modelpos", "modelvel", "modelacc"),
    ),
    Question(
        name="joints",
        fact="cylindrical arm: base rotation phi, vertical z, radial arm r",
        confidence="H",
        ask=_vectors("measposjoint", "modelposjoint", "modelveljoint", "modelaccjoint", "measforcejoint"),
    ),
    Question(
        name="end stops",
        fact="end stops r -0.19..0.19 m, phi -0.504..0.507 rad, z -0.228..0.228 m: 79 l; published 80 l",
        confidence="H",
        ask=_end_stops,
    ),
    Question(name="R0", fact="R0 about 0.45 m", confidence="H", ask=_column),
    Question(
        name="kinematics",
        fact="x = (R0+r) cos phi - R0, y = (R0+r) sin phi, z",
        confidence="H",
        ask=_kinematics,
    ),
    Question(name="numbers", fact="numbers as `%g`, 6 significant digits", confidence="H", ask=_format),
    Question(
        name="unknown quantity",
        fact="error replies contain `--- ERROR`",
        confidence="H",
        ask=_refusal("get hmcheckquantity"),
    ),
    Question(
        name="object that does not exist",
        fact="names of objects that do not exist pass silently",
        confidence="M",
        ask=_refusal("get hmcheckobject pos"),
    ),
    Question(
        name="several commands",
        fact="several commands in one text request",
        confidence="H",
        ask=_combined,
    ),
    Question(name="second connection", fact="several clients", confidence="C", ask=_second_client),
    Question(
        name="noise of the force sensor",
        fact="noise, offset, drift, range of the force sensor",
        confidence="C",
        ask=_noise,
    ),
)
"""In this order; the first ones tell most."""
