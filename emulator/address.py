"""Where the emulator listens."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from hm_driver.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Address:
    """A host of this machine and a port; port 0 for a free one."""

    host: str = "127.0.0.1"
    port: int = 0

    def __str__(self) -> str:
        return f"tcp://{self.bracketed_host}:{self.port}"

    @property
    def bracketed_host(self) -> str:
        """The host as a URL has it."""
        return f"[{self.host}]" if ":" in self.host else self.host


def parse_address(field: str, url: str, *, default_port: int) -> Address:
    """Read ``tcp://HOST[:PORT]``.

    Raises:
        ConfigurationError: Something else; names the field.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ConfigurationError(field, f"{url!r}: {error}; accepted: tcp://HOST[:PORT]") from error
    if parts.scheme != "tcp" or not parts.hostname or parts.path not in ("", "/") or parts.query:
        raise ConfigurationError(field, f"{url!r} is no address; accepted: tcp://HOST[:PORT]")
    return Address(parts.hostname, default_port if port is None else port)
