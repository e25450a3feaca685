import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from hm_driver.protocol.framing import Dialect
from hm_driver.transport.urls import available_schemes, open_transport, parse_device_url


def test_the_device_port_is_the_default():
    url = parse_device_url("tcp://192.168.0.25")
    assert (url.scheme, url.host, url.port, url.dialect) == ("tcp", "192.168.0.25", 7654, None)


def test_port_dialect_and_other_options_are_taken_apart():
    url = parse_device_url("tcp://[::1]:80?dialect=framed&x=1")
    assert (url.host, url.port, url.dialect, dict(url.options)) == ("::1", 80, Dialect.FRAMED, {"x": "1"})


def test_a_unix_url_carries_its_path():
    assert parse_device_url("unix:///run/hm.sock").path == "/run/hm.sock"


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("192.168.0.25", "tcp://192.168.0.25"),
        ("tcp://", "names no host"),
        ("tcp://h:99999", "0-65535"),
        ("tcp://h:abc", "abc"),
        ("tcp://h?dialect=binary", "auto, text, framed"),
        ("tcp://h?a=1&a=2", "twice"),
    ],
)
def test_a_wrong_url_is_refused_with_what_would_be_right(url, said):
    with pytest.raises(ConfigurationError, match=said):
        parse_device_url(url)


def test_an_unknown_scheme_lists_those_there_are():
    with pytest.raises(ConfigurationError, match=r"carrier-pigeon.*sim.*tcp.*unix"):
        open_transport("carrier-pigeon://loft")


def test_schemes_of_installed_packages_are_offered():
    assert {"sim", "tcp", "unix"} <= set(available_schemes())


@given(st.text())
def test_any_text_is_a_url_or_a_configuration_error(text):
    with contextlib.suppress(ConfigurationError):
        assert parse_device_url(text).url == text
