"""Strict reading of replies, in both dialects.

A text reply closes every part by ``;`` (``[0,0,0];stop;``); a framed reply has one part, and its words stand
in double quotes (``"stop"``). The functions that read one part take it from either dialect.

>>> [parse_vector(part) for part in split_parts("[0,0,0.1];[1,2,3];")]
[(0.0, 0.0, 0.1), (1.0, 2.0, 3.0)]
"""

from collections.abc import Callable
from typing import TypeVar

from hm_driver.errors import DeviceError, ProtocolError
from hm_driver.protocol.vocabulary import ERROR_MARK, Quaternion, Vector

_Value = TypeVar("_Value")


def read_reply(read: Callable[[str], _Value], command: str, reply: str) -> _Value:
    """Read a reply by one of the functions below; where it cannot be read the error names the command.

    Raises:
        ProtocolError: The reply is not what `read` takes.
    """
    try:
        return read(reply)
    except ProtocolError as error:
        raise error.about(command) from error


def split_parts(text: str) -> list[str]:
    """Split a text reply into its parts; each is closed by ``;``.

    Raises:
        ProtocolError: The last part is not closed, so the reply may be cut off.
    """
    parts = text.split(";")
    if parts[-1].strip():
        raise ProtocolError(f"reply {_shown(text)} does not end with ';': it was cut off", received=text)
    del parts[-1]
    return parts


def split_reply(text: str) -> list[str]:
    """Split a reply of either dialect: a framed reply is one part as it stands."""
    return split_parts(text) if text.endswith(";") else [text]


def parse_vector(text: str) -> Vector:
    """Read ``[x,y,z]``.

    Raises:
        ProtocolError: Other than three finite numbers in brackets.
    """
    try:
        if text[0] == "[" and text[-1] == "]" and "_" not in text:
            x, y, z = text[1:-1].split(",")
            vector = (float(x), float(y), float(z))
            total = vector[0] + vector[1] + vector[2]
            if total - total == 0.0:
                return vector
    except (ValueError, IndexError):
        pass
    raise _mismatch(text, "a vector [x,y,z] of finite numbers")


def parse_quaternion(text: str) -> Quaternion:
    """Read ``[x,y,z,w]``.

    Raises:
        ProtocolError: Other than four finite numbers in brackets.
    """
    try:
        if text[0] == "[" and text[-1] == "]" and "_" not in text:
            x, y, z, w = (float(component) for component in text[1:-1].split(","))
            total = x + y + z + w
            if total - total == 0.0:
                return x, y, z, w
    except (ValueError, IndexError):
        pass
    raise _mismatch(text, "a quaternion [x,y,z,w] of finite numbers")


def parse_number(text: str) -> float:
    """Read a number.

    Raises:
        ProtocolError: Not a finite number.
    """
    try:
        number = float(text)
    except ValueError:
        raise _mismatch(text, "a finite number") from None
    if number - number != 0.0 or "_" in text:
        raise _mismatch(text, "a finite number")
    return number


def parse_bool(text: str) -> bool:
    """Read ``true`` or ``false``, quoted or not.

    Raises:
        ProtocolError: Another word.
    """
    word = parse_word(text)
    if word == "true":
        return True
    if word == "false":
        return False
    raise _mismatch(text, "true or false")


def parse_word(text: str) -> str:
    """Read a word or a message, quoted or not.

    Raises:
        ProtocolError: Nothing there, or half a pair of quotes.
    """
    word = text.strip()
    if len(word) > 1 and word[0] == word[-1] == '"':
        word = word[1:-1]
    if not word or '"' in word:
        raise _mismatch(text, "a word")
    return word


def is_error(reply: str) -> bool:
    """Whether a reply refuses the command."""
    return ERROR_MARK in reply


def raise_if_error(command: str, reply: str) -> None:
    """Turn a reply that refuses the command into an exception.

    Raises:
        DeviceError: The reply is an error.
    """
    if ERROR_MARK in reply:
        raise DeviceError(command, reply.strip('"; '))


def _mismatch(text: str, expected: str) -> ProtocolError:
    return ProtocolError(f"reply {_shown(text)} is not {expected}", received=text)


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
