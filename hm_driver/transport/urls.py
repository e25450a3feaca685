"""Open a transport by URL: ``tcp://192.168.0.25:7654?dialect=text``, ``unix:///run/hm.sock``, ``sim://``.

Third parties add a scheme by an entry point in the group ``hm_driver.transports``: its name is the scheme,
its value an opener, a function that takes a `DeviceUrl` and ``timeout_s`` and returns an open `Transport`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol
from urllib.parse import parse_qsl, urlsplit

from hm_driver.errors import ConfigurationError
from hm_driver.protocol.framing import Dialect
from hm_driver.transport.contract import Transport

DEFAULT_PORT = 7654
"""TCP port of the device (device facts, confidence H)."""

ENTRY_POINT_GROUP = "hm_driver.transports"

BUILT_IN_SCHEMES = ("tcp", "unix")


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceUrl:
    """A device's address, taken apart."""

    url: str
    """As the user wrote it."""
    scheme: str
    host: str = ""
    port: int | None = None
    """TCP port; the device's own where the URL names none."""
    path: str = ""
    dialect: Dialect | None = None
    """None for ``auto``: find out by asking."""
    options: Mapping[str, str] = field(default_factory=dict)
    """What else stood behind the ``?``, for the transport."""

    def refuse_options(self) -> None:
        """Check that no option is left; for transports that know none.

        Raises:
            ConfigurationError: There is one.
        """
        if self.options:
            raise ConfigurationError(
                "device",
                f"{self.url}: unknown option {', '.join(self.options)}; {self.scheme} knows: dialect",
            )


class TransportOpener(Protocol):
    """What an entry point in the group ``hm_driver.transports`` names."""

    def __call__(self, url: DeviceUrl, *, timeout_s: float) -> Transport:
        """Open a transport within `timeout_s`, which is also its limit for a `send`; see `open_transport`."""
        ...


def parse_device_url(url: str) -> DeviceUrl:
    """Take a device's URL apart.

    Raises:
        ConfigurationError: No URL, a port that is none, an unknown dialect or an option given twice.
    """
    if "://" not in url:
        raise ConfigurationError("device", f"{url!r} is no URL; did you mean tcp://{url or 'HOST'}?")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ConfigurationError("device", f"{url!r}: {error}") from error
    pairs = parse_qsl(parts.query, keep_blank_values=True)
    options = dict(pairs)
    if len(options) < len(pairs):
        raise ConfigurationError("device", f"{url!r}: an option is given twice")
    dialect = _parse_dialect(url, options.pop("dialect", "auto"))
    if parts.scheme == "tcp" and not parts.hostname:
        raise ConfigurationError("device", f"{url!r} names no host; write tcp://HOST[:{DEFAULT_PORT}]")
    return DeviceUrl(
        url=url,
        scheme=parts.scheme,
        host=parts.hostname or "",
        port=DEFAULT_PORT if parts.scheme == "tcp" and port is None else port,
        path=parts.path,
        dialect=dialect,
        options=MappingProxyType(options),
    )


def open_transport(url: str | DeviceUrl, *, timeout_s: float = 1.0) -> Transport:
    """Open the link that a URL names.

    Args:
        url: ``tcp://HOST[:PORT]``, ``unix:///PATH``, or a scheme that an entry point adds.
        timeout_s: Longest wait for the connection, and later for the peer to take what is sent [s].

    Raises:
        ConfigurationError: The URL is wrong or its scheme unknown; the text lists those there are.
        TransportTimeout: No connection in time.
        TransportError: Nothing listens there, or the host is unknown.
    """
    target = parse_device_url(url) if isinstance(url, str) else url
    return _find_opener(target)(target, timeout_s=timeout_s)


def available_schemes() -> tuple[str, ...]:
    """Schemes that can be opened: built in, and added by installed packages."""
    from importlib.metadata import entry_points

    return tuple(sorted({*BUILT_IN_SCHEMES, *entry_points(group=ENTRY_POINT_GROUP).names}))


def _parse_dialect(url: str, word: str) -> Dialect | None:
    if word == "auto":
        return None
    try:
        return Dialect(word)
    except ValueError:
        known = ", ".join(["auto", *(dialect.value for dialect in Dialect)])
        raise ConfigurationError(
            "device", f"{url!r}: dialect {word!r} is unknown; accepted: {known}"
        ) from None


def _find_opener(target: DeviceUrl) -> TransportOpener:
    if target.scheme in BUILT_IN_SCHEMES:
        from hm_driver.transport import tcp

        return tcp.open_tcp if target.scheme == "tcp" else tcp.open_unix
    from importlib.metadata import entry_points

    for entry_point in entry_points(group=ENTRY_POINT_GROUP, name=target.scheme):
        opener: TransportOpener = entry_point.load()
        return opener
    raise ConfigurationError(
        "device",
        f"{target.url!r}: scheme {target.scheme!r} is unknown; there are: {', '.join(available_schemes())}",
    )
