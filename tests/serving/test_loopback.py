"""Pages of other sites, which any browser here can send to 127.0.0.1, get no answer."""

import pytest

from trinoc.serving.loopback import may_ask


@pytest.mark.parametrize("host", ["127.0.0.1:8642", "localhost", "LocalHost:1", "[::1]:8642"])
def test_a_page_of_this_machine_may_ask(host: str) -> None:
    assert may_ask([host], [])
    assert may_ask([host], [f"http://{host}"])


@pytest.mark.parametrize(
    "hosts",
    [
        *([], ["127.0.0.1", "127.0.0.1"], [""]),
        *(["evil.example"], ["evil.example:8642"], ["localhost.evil.example"]),
        *(["127.0.0.1.evil.example"], ["127.0.0.1@evil.example"], ["evil.example#localhost"]),
        *(["localhost:8642.evil.example"], ["localhost\n"], ["0.0.0.0"], ["192.168.0.2:8642"]),
    ],
)
def test_other_names_may_not(hosts: list[str]) -> None:
    assert not may_ask(hosts, [])


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "https://localhost:8642", "http://localhost:1"]
)
def test_nor_may_pages_of_other_sites_and_ports(origin: str) -> None:
    assert not may_ask(["localhost:8642"], [origin])
    assert not may_ask(["localhost:8642"], ["http://localhost:8642", origin])
