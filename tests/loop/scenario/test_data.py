"""Registered data: found, fetched from a server on this machine, refused when it is not what it should be."""

import hashlib
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from luxloop.loop.scenario import data
from luxloop.loop.scenario.data import DataFile, Download
from tests.refusal import refusal

CONTENT = b"$ROAD_CRG\r\n\x00\xff a scan\n"
REAL = data.registry()
Known = Callable[..., None]


@pytest.fixture
def known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Known:
    """Makes "setts" the only file of the registry, on a machine that has fetched nothing yet."""
    monkeypatch.delenv(data.FOLDER_VARIABLE, raising=False)
    monkeypatch.delenv(data.MIRROR_VARIABLE, raising=False)
    monkeypatch.setattr(data, "cache_folder", lambda: tmp_path / "cache")

    def known(url: str = "http://127.0.0.1:9", content: bytes = CONTENT, file: str = "roads/setts.crg") -> None:
        sha256 = hashlib.sha256(content).hexdigest()
        setts = DataFile("setts", file, "road", "stones", "Apache-2.0", len(content), sha256, f"{url}/{file}")
        monkeypatch.setattr(data, "registry", lambda: {"setts": setts})

    return known


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """Address of a server that has one road."""
    root = tmp_path / "server"
    (root / "roads").mkdir(parents=True)
    (root / "roads" / "setts.crg").write_bytes(CONTENT)

    class Quiet(SimpleHTTPRequestHandler):
        def __init__(self, *args: object) -> None:
            super().__init__(*args, directory=str(root))

        def log_message(self, *_: object) -> None: ...

    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Quiet)
    thread = threading.Thread(target=httpd.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{httpd.server_port}"
    httpd.shutdown()
    httpd.server_close()
    thread.join()


def test_a_file_is_fetched_once_then_found_and_again_when_it_has_changed(server, known, tmp_path):
    known(server)
    with refusal("`luxloop data get setts`"):
        data.find("setts")
    path = tmp_path / "cache" / "roads" / "setts.crg"
    assert data.get("setts") == Download(path, downloaded=True) and path.read_bytes() == CONTENT
    assert data.get("setts") == Download(path, downloaded=False) and data.find("setts") == data.locate("setts") == path
    assert [each for each in (tmp_path / "cache").rglob("*") if each.is_file()] == [path]
    path.write_bytes(b"spoilt")
    assert data.get("setts").downloaded and path.read_bytes() == CONTENT


def test_a_mirror_stands_in_for_the_source(server, known, tmp_path, monkeypatch):
    known()
    monkeypatch.setenv(data.MIRROR_VARIABLE, server + "/")
    path = data.get("setts", directory=tmp_path / "mine").path
    assert path == tmp_path / "mine" / "roads" / "setts.crg"
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "mine"))  # the folder given is one that LUXLOOP_DATA may name
    assert data.find("setts") == path


@pytest.mark.parametrize("place", ["roads/setts.crg", "setts.crg"])
def test_copies_at_hand_come_first_and_are_left_alone(known, tmp_path, monkeypatch, place):
    known()  # whose address leads nowhere
    copy = tmp_path / "own" / place
    copy.parent.mkdir(parents=True)
    copy.write_bytes(CONTENT)
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "own"))
    assert data.get("setts") == Download(copy, downloaded=False)
    copy.write_bytes(b"mine")
    with refusal(r"setts\.crg: is not 'setts' as registered \(SHA-256 differs\); move it away"):
        data.get("setts")
    assert copy.read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"content": b"something else"}, r"SHA-256 differs\); nothing was kept"),
        ({"file": "roads/none.crg"}, r"none\.crg cannot be fetched: 404 .* save it by hand as .*none\.crg"),
        ({"url": "http://127.0.0.1:9"}, r"cannot be reached; connect .* LUXLOOP_DATA to a folder with roads/setts\.crg"),  # nobody listens
    ],
)
def test_what_cannot_be_fetched_is_not_kept(server, known, tmp_path, wrong, words):
    known(**{"url": server, **wrong})
    with refusal(words):
        data.get("setts")
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def test_a_folder_that_cannot_be_written(server, known, tmp_path):
    known(server)
    (tmp_path / "file").write_text("")
    with refusal(r"cannot be written .* --dir"):
        data.get("setts", directory=tmp_path / "file")


def test_names(monkeypatch, tmp_path):
    for name, words in (("belgian_blocks", "did you mean 'belgian_block'"), ("xyzzy", "`luxloop data list` shows all")):
        with refusal(words):
            data.find(name)
    assert data.locate("roads/own.crg") == Path("roads/own.crg")
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "nowhere"))
    with refusal(r"LUXLOOP_DATA names .*nowhere, which is not a folder"):
        data.find("belgian_block")


def test_the_registry_pins_every_source():
    assert {each.kind for each in REAL.values()} == {"road", "photometric"}
    for each in REAL.values():
        assert each.name == Path(each.file).stem and len(each.sha256) == 64
        # A 40-digit commit in the address: a branch would move under the SHA-256.
        assert each.url.startswith("https://raw.githubusercontent.com/") and len(each.url.split("/")[5]) == 40
        assert each.url.endswith("/" + Path(each.file).name)


def test_registry_agrees_with_copies_at_hand(data_dir):
    copies = [each for each in REAL.values() if (data_dir / each.file).is_file()]
    assert copies
    for each in copies:
        content = (data_dir / each.file).read_bytes()
        assert (len(content), hashlib.sha256(content).hexdigest()) == (each.bytes, each.sha256), each.name
