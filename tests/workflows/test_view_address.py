"""Where `e4dgs view` listens: what cannot be listened on is an error at once, and what is printed can be opened."""

import logging
import os
import socket
import threading
import warnings

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.cli import main
from e4dgs.workflows.view.address import SCREENS, addresses, listening, open_page, over_ssh
from e4dgs.workflows.view.quiet import NOISY, hush, unsaid


@pytest.mark.parametrize(
    ("host", "words"),
    [
        ("198.51.100.7", "not an address of this machine"),  # reserved for documentation
        ("nosuch.invalid", "no such name or address"),
        ("", "no such name or address"),
        ("a" * 70 + ".invalid", "no such name or address"),
    ],
)
def test_a_host_that_cannot_be_listened_on_is_an_error_before_anything_is_loaded(host, words, tmp_path, capsys):
    assert main(["view", str(tmp_path), "--workspace", str(tmp_path / "w"), "--preset", "fast", "--host", host, "--no-browser"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert told.startswith(f"error: --host {host}".rstrip()) and words in told


@pytest.mark.parametrize(
    ("platform", "screen", "opens"), [("linux", "", False), *(("linux", name, True) for name in SCREENS), ("darwin", "", True)]
)
def test_a_page_is_opened_where_there_is_a_screen_and_nobody_waits_for_the_browser(monkeypatch, platform, screen, opens):
    opened, closed = threading.Event(), threading.Event()

    def browse(address):
        assert address == "http://x"
        opened.set()
        closed.wait(20)

    for name in SCREENS:
        monkeypatch.setenv(name, "1" if name == screen else "")
    monkeypatch.setattr("sys.platform", platform)
    monkeypatch.setattr("webbrowser.open", browse)
    open_page("http://x")
    assert opened.wait(20 if opens else 0.2) == opens
    closed.set()


def test_a_port_in_use_gives_the_next():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        host, found = listening("localhost", port)
        assert host in ("127.0.0.1", "::1")
        assert listening("127.0.0.1", port)[1] > port
    assert found >= port and listening("127.0.0.1", port) == ("127.0.0.1", port)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may listen on every port")
def test_a_port_that_may_not_be_used_is_named():
    with pytest.raises(SettingsError, match="--port 1: cannot listen"):
        listening("127.0.0.1", 1)


def test_every_printed_address_is_one():
    assert addresses("127.0.0.1", 80) == addresses("localhost", 80) == ["http://localhost:80"]
    assert addresses("::1", 80) == ["http://[::1]:80"] and addresses("10.1.2.3", 80) == ["http://10.1.2.3:80"]
    for host, here in (("0.0.0.0", "http://localhost:80"), ("::", "http://[::1]:80")):
        first, second = addresses(host, 80)
        assert first == here and second not in (f"http://{host}:80", f"http://[{host}]:80")


def test_over_ssh_it_says_how_to_forward_the_port(monkeypatch):
    monkeypatch.setenv("SSH_CONNECTION", "10.0.0.1 5000 10.0.0.2 22")
    monkeypatch.setenv("LOGNAME", "ada")
    told = over_ssh("127.0.0.1", 8080)
    assert told == "on your own machine: ssh -L 8080:localhost:8080 ada@10.0.0.2, then open http://localhost:8080 there"
    monkeypatch.setenv("SSH_CONNECTION", "10.0.0.1 5000 10.0.0.2 2222")
    assert "-p 2222 ada@10.0.0.2" in over_ssh("127.0.0.1", 8080)
    assert "-L 8080:[::1]:8080 " in over_ssh("::1", 8080)
    assert over_ssh("0.0.0.0", 8080) is None and over_ssh("::", 8080) is None, "the page can be reached directly"
    monkeypatch.setenv("SSH_CONNECTION", "$(odd) x y z")
    assert "$" not in over_ssh("localhost", 8080)
    monkeypatch.delenv("SSH_CONNECTION")
    assert over_ssh("127.0.0.1", 8080) is None


def test_the_server_says_nothing_to_itself_aloud(capsys):
    level = logging.getLogger(NOISY).level
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            hush()
            warnings.warn("Queued a BackgroundImageMessage on a closed connection (e.g. via a handle)", stacklevel=1)
            warnings.warn("anything else", stacklevel=1)
        assert [str(one.message) for one in caught] == ["anything else"]
        logging.getLogger(NOISY).error("opening handshake failed")
    finally:
        logging.getLogger(NOISY).setLevel(level)
    with unsaid():
        print("Server stopped")
    assert capsys.readouterr() == ("", "")
